"""Symbolic dynamics, kinematics and deflection of an arm, tested against pinocchio."""
