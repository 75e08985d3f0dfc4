"""The effects that are missing: candidates, their evidence, the best of them together."""
