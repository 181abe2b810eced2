"""How taut the strands are: the least pretension, and what a path or pose asks of strands and motors."""
