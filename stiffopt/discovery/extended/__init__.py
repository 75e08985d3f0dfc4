"""The nominal model with what was found: as a file, and as a robot to plan with."""
