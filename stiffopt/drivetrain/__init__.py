"""Drivetrains: connections in series and parallel, seen from the joint."""
