"""What controllers did: errors, tensions, training, corrections; their figures and the sections of a run's report."""
