"""Trajectory problems: statement, files, checks before solving, and their formulation."""
