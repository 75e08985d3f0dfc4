"""What recordings say and what the nominal model says of the same motion."""
