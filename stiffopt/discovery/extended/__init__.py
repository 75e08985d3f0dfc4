"""Extended model, the nominal model with findings: its file, and a robot to plan with."""
