"""What can be minimised, one kind a file; each adds itself to `problem.objective.OBJECTIVES`."""
