"""Assessment of findings: explained shares, unexplained residual, detection limits."""
