"""The colours of figures and report: told apart without colour vision, on white and on dark paper.

A figure is drawn in the light colours. In the report its colours become CSS variables, so that it follows the
reader's choice of light or dark; every light colour is therefore used for one purpose only.
"""

LIGHT = {
    "ink": "#17212b",  # text and what must be read
    "muted": "#5b6875",  # secondary text, tick labels
    "rule": "#dde3e8",  # grid and thin lines
    "paper": "#ffffff",
    "panel": "#f5f7f9",  # cards, stripes
    "reference": "#4a5560",  # what the others are compared with
    "grey": "#87929e",
    "blue": "#1b6cb3",
    "orange": "#d4570b",
    "teal": "#0b8a6c",
    "violet": "#8552b0",
    "ochre": "#b08500",
    "good": "#0f7a4f",
    "bad": "#b42318",
}

DARK = {
    "ink": "#e8edf2",
    "muted": "#9aa7b4",
    "rule": "#2c3640",
    "paper": "#12171c",
    "panel": "#1a2128",
    "reference": "#c3ccd5",
    "grey": "#8f9aa6",
    "blue": "#5fadee",
    "orange": "#ff9350",
    "teal": "#3fc9a2",
    "violet": "#c39aec",
    "ochre": "#e3bf45",
    "good": "#4cc38a",
    "bad": "#ff8a7a",
}

SERIES = ("blue", "orange", "teal", "violet", "ochre", "grey")
"""Order of colours where nothing has a colour of its own."""

_CONTROLLERS = {
    "fabrik": ("orange", (0, (1, 1.2))),
    "least_squares": ("grey", (0, (4, 1.6))),
    "nominal": ("grey", (0, (4, 1.6))),
    "learned_ik": ("blue", "-"),
    "learned_ik+integral": ("teal", "-"),
    "learned_ik+dither": ("violet", (0, (4, 1.6))),
    "learned_ik+dither+integral": ("teal", (0, (4, 1.6))),
    "learned_ik+dither+estimate": ("violet", "-"),
}
_POLICY = ("orange", "-")
_LINES = ("-", (0, (4, 1.6)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)))


def series_colour(index: int) -> str:
    """Hex colour of the series number `index`."""
    return LIGHT[SERIES[index % len(SERIES)]]


def controller_look(name: str, index: int) -> dict:
    """Line colour and dashes of a controller: always the same for the known ones, and for every policy.

    Args:
        index: position among the controllers shown, for the looks of unknown ones.
    """
    unknown = (SERIES[index % len(SERIES)], _LINES[index % len(_LINES)])
    colour, dashes = _POLICY if name.endswith("+residual") else _CONTROLLERS.get(name, unknown)
    return {"color": LIGHT[colour], "linestyle": dashes}


PARTS = {
    "link_0": "#3f5f7f",  # of every other section
    "link_1": "#6f94b8",
    "plate": "#2b3640",
    "limb": "#c79a3e",
    "strand": "#c2543a",
    "base": "#9aa5b0",
}
"""Of a drawn robot: the same on white and on dark paper."""

AXES = (LIGHT["orange"], LIGHT["teal"], LIGHT["blue"])
"""x, y, z of a drawn frame."""
