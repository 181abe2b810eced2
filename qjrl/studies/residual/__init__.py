"""What a residual policy does, and why."""
