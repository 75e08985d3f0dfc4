"""Preload design studies: how tight the bolts and pins of each joint must be."""
