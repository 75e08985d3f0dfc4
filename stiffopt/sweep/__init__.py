"""Resumable parallel sweeps of problems, studies and diagnoses over values of their entries."""
