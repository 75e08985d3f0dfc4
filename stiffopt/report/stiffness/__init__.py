"""Report of a robot's joint stiffness."""
