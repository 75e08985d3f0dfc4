"""Motion of an arm in space: an interactive 3D scene in the browser, and a still picture."""
