"""Recordings of real or simulated robots: reading, cleaning, checking."""
