"""Training runs against the nominal model: prediction, nuisance values, rows, evidence."""
