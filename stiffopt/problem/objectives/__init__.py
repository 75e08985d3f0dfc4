"""Kinds of objective; each registers itself in `problem.objective.OBJECTIVES`."""
