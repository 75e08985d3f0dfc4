"""Pick-and-place programs of random arms with something concealed, diagnosed as a user would."""
