"""Joint stiffness from deflections that were measured under known forces."""
