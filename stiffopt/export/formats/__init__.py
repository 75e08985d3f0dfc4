"""Formats of exported motions, one a file; each adds itself to `export.format.FORMATS`."""
