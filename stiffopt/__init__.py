"""Stiff and true trajectories for industrial robot arms."""

__version__ = "0.1.0"
