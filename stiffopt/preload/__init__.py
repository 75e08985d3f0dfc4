"""Preload design studies: optimum preloads of bolts and pins of each joint."""
