"""Helpers shared by several test folders lie beside this file, which makes them importable."""
