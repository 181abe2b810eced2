"""A path of poses: read from files or made of shapes, its errors, its inversion to cable lengths."""
