"""Results of a solve: status, trajectory, assessment, and their files."""
