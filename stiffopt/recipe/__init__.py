"""Recipe of a stored result: read for comparisons and warm starts, and solved again."""
