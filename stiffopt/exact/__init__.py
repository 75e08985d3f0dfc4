"""Stiffness laws before any smoothing or fitting: what motions and preloads are judged by."""
