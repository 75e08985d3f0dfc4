"""Grammar of mechanical laws: products of fitted functions of signals, as effects and as text."""
