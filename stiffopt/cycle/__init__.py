"""Working cycles: their legs solved, their time split, their stops simulated."""
