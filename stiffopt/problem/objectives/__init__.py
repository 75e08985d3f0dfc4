"""Kinds of objective, one per file; each registers itself in `problem.objective.OBJECTIVES`."""
