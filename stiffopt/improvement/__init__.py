"""Improvement of a given motion: the same path, within limits, with motors that lead."""
