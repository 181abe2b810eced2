"""How well a path was followed."""
