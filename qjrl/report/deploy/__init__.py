"""What a deployment looks like: latency, errors, flags, the arm in motion."""
