"""Report of a trajectory."""
