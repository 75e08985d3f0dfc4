"""Report of an identified joint stiffness."""
