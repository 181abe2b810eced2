"""What keeps every strand taut."""
