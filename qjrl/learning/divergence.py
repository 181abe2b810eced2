"""What a training raises when its numbers are no longer numbers."""


class TrainingDiverged(RuntimeError):  # noqa: N818
    """Too many samples, or the loss itself, are not finite. The message says which, how many, and what to try."""
