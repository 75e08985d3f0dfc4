"""Reports of one page each: budget, cycle, identification, improvement, stiffness, sweep."""
