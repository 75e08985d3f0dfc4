"""Search for missing effects: candidates, their evidence, joint fits and rivals."""
