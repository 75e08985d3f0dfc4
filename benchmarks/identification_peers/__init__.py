"""Identification by others on recordings of real robots, each in an environment of its own."""
