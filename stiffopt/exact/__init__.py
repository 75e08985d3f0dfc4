"""Unsmoothed stiffness laws, by which the certificate judges motions and preloads."""
