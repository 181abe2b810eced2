"""Elements of a MuJoCo XML from Python values; floats are written with repr, so that compiled lengths are exact."""

from xml.etree import ElementTree

import numpy as np


def add_element(parent: ElementTree.Element, tag: str, **attributes) -> ElementTree.Element:
    """A child element; numbers, booleans and sequences of them become MuJoCo's texts."""
    return ElementTree.SubElement(parent, tag, {key: _text(value) for key, value in attributes.items()})


def _text(value) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, bool | int):
        return str(value).lower()
    if isinstance(value, float | np.floating):
        return repr(float(value))
    return " ".join(_text(item) for item in value)
