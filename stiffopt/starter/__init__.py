"""Files to begin with: a robot file, a problem, a recording set or a flange from what one has."""
