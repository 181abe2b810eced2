"""What the tip reaches, measured and compared."""
