"""Design of the next experiment: the motion that separates the two leading explanations best."""
