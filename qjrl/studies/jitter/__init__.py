"""Joint velocities at rest, C MuJoCo against MJX, of strands that are servos and of strands that are tendon limits."""
