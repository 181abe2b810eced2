"""Experiments: each folder is one, with its stage, what it measures, its figures and its report. None imports another."""
