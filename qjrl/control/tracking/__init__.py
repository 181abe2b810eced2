"""A path of poses becomes a cable trajectory, is played in the physics and evaluated."""
