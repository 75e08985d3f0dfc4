"""Initial files from a URDF, recordings or a flange: robot file, problem, recording set."""
