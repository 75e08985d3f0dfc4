"""What was found, assessed: how much it explains, what remains, what would have been seen."""
