"""What controllers did: tensions, training, and the sections of a run's report."""
