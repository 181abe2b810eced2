"""Which forward model for how many rows."""
