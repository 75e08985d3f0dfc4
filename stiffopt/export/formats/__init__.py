"""Motion formats, one per file; each registers itself in `export.format.FORMATS`."""
