"""From a problem to a certified solution: start, stages, IPOPT, refinement."""
