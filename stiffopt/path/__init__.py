"""Timing of paths under limits of every derivative, and search of collision-free paths."""
