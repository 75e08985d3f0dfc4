"""Random trajectory problems that can be met, and some that cannot, solved and counted."""
