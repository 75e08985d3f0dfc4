"""Whether recordings can be what recordings.toml says: units, signs, order, delay, gravity."""
