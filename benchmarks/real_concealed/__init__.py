"""Known things hidden in recordings of real robots by a sealed draw, and whether they are found."""
