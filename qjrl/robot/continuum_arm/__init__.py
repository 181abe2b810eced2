"""The cable-driven continuum arm: segments of a flexible backbone, each bent by its own cables (paper 002)."""
