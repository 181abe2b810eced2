"""How far the joint's path leaves the circle, and what that does."""
