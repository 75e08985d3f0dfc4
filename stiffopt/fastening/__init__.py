"""Strength and tightening of bolts and set screws."""
