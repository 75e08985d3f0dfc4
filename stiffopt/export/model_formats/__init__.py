"""Robot formats, one per file; each registers itself in `export.model_format`."""
