"""The elastic arm: links that swing on the springs of their joints, simulated and linearised."""
