"""Export of motions and robots for controllers, simulators and other tools, one format per file."""
