"""Rough surfaces in contact: from nominal pressure [Pa] to stiffness per area [N/m^3]."""
