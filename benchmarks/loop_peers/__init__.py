"""Peers of a diagnosis from commands: forward-simulation fits of given parameters in MuJoCo."""
