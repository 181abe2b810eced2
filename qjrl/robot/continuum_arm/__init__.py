"""The continuum arm: segments of an elastic rod that cables bend."""
