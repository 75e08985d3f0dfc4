"""Solvers of transcribed problems."""
