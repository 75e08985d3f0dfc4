"""Report of an improved motion."""
