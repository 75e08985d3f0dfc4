"""CasADi functions at many points at once: batches of instructions that a compiled loop reads."""
