"""Closed loop of arm and actuators: simulation from commands alone, and fit of its parameters."""
