"""Error budget of the tool: geometry, elasticity, servo and temperature by linear propagation."""
