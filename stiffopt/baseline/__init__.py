"""Motions to compare with: what an engineer gets today on the straight joint path."""
