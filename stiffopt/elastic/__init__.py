"""Elastic arm: vibration of the links on the springs of their joints, simulated and linearised."""
