"""Actuators: torque of a joint from its command and its motion, one kind of control law a file."""
