"""Report of an error budget."""
