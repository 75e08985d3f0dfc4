"""Formats of exported robots, one a file; each adds itself to `export.model_format`."""
