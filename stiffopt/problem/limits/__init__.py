"""Kinds of limit, one per file; each registers itself in `problem.limit.LIMITS`."""
