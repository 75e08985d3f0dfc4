"""Symbolic dynamics and kinematics of an arm, and its deflection; pin is the oracle."""
