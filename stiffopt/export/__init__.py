"""A solved motion as files that controllers and other tools read, one format a file."""
