"""Sealed benchmark: effects that are concealed from the tool, found or not."""
