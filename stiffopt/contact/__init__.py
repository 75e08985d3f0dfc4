"""Contact of rough surfaces: stiffness per area [N/m^3] over nominal pressure [Pa]."""
