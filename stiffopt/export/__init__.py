"""Export of motions and robots for controllers, simulators and other tools, by format."""
