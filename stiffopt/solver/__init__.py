"""Solution of trajectory problems: initial guess, stages, IPOPT, refinement, verdict."""
