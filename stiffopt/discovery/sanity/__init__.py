"""Plausibility of recordings against recordings.toml: units, signs, order, delay, gravity."""
