"""Readers of run files, one format a module."""
