"""Rough contacts: pressure [Pa] to stiffness per area [N/m^3]."""
