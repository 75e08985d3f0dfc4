"""The next motion: the one that separates the two leading explanations best."""
