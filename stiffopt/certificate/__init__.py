"""Certification on a fine grid with the unsmoothed model, independent of the optimiser."""
