"""Sweeps: a problem, study or diagnosis for many values of its entries, resumable, in parallel."""
