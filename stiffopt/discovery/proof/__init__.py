"""Predictions of runs that no fit has seen, before and after."""
