"""The door: arguments in, exit code out. Only here are Hydra and the process environment known."""
