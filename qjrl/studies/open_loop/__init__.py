"""Commands of the inverse-kinematics methods, settled in the physics."""
