"""Motion formats, one or a family per file; each registers itself in `export.format.FORMATS`."""
