"""Report of a working cycle."""
