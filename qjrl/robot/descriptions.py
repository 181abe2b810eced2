"""What the descriptions of all kinds of robots have in common: ranges of their numbers, and what a name may be."""

from typing import Annotated

from qjrl.config import Range
from qjrl.field_words import show

Positive = Range(above=0.0)
NonNegative = Range(low=0.0)
Number = Annotated[int, Range(low=0)]
LONGEST_NAME = 100
"""Letters; reports and file formats carry it."""


def check_name(name: str) -> None:
    """Refuse a robot's name that is empty, longer than that or not on one line.

    Raises:
        ValueError: one line.
    """
    if not (name.strip() and name.isprintable() and len(name) <= LONGEST_NAME):
        raise ValueError(f"name: got {show(name)}, allowed: a text on one line, up to {LONGEST_NAME} letters")
