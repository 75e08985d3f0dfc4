"""Kinds of limit; each registers itself in `problem.limit.LIMITS`."""
