"""Rotations and the 9-number pose, for one sample; callers vmap."""
