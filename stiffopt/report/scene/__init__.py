"""A motion of an arm in space: a scene to turn and play in a browser, and a still of it."""
