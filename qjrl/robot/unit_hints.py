"""The end of an error line that says which other unit would explain a number."""


def length_hint(excess: float) -> str:
    """Of a length in metres that is `excess` times what is allowed; empty where millimetres would not explain it."""
    return "; in millimetres? divide by 1,000" if 1.0 < excess <= 1000.0 else ""


def angle_hint(degrees: float, allowed: float) -> str:
    """Of an angle in degrees that is smaller than any allowed one [deg]; empty where radians would not explain it."""
    return "; in radians? multiply by 57.3" if degrees < allowed <= 57.3 * degrees else ""


def bend_hint(size: float) -> str:
    """Of a bend of length 1 or more: an angle stands where the sine of half of it is asked for."""
    unit = "degrees" if size > 3.2 else "radians"
    return f"; angles in {unit}? bends_from_angles makes bends of them, in radians"
