"""Report of a preload study."""
