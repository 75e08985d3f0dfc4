"""What can limit a motion, one kind a file; each adds itself to `problem.limit.LIMITS`."""
