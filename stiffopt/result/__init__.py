"""What a solve returns: status, trajectory, assessment, and the files they are written to."""
