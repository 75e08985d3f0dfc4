"""What was found, judged: how much it explains, what remains, what would have been seen."""
