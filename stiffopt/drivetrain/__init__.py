"""Drivetrains: connections in series and parallel, referred to the joint."""
