"""Vectors and matrices as separate components, each (*batch): nothing is copied to take them apart or to put them together.

A component may be a Python number. Zeros and ones among them cost no operation.
"""

from typing import Any

from flax import struct


@struct.dataclass
class Vector:
    """Three components."""

    x: Any
    y: Any
    z: Any

    def __add__(self, other: "Vector") -> "Vector":
        return Vector(add(self.x, other.x), add(self.y, other.y), add(self.z, other.z))

    def __sub__(self, other: "Vector") -> "Vector":
        return Vector(subtract(self.x, other.x), subtract(self.y, other.y), subtract(self.z, other.z))

    def scaled(self, factor: Any) -> "Vector":
        return Vector(times(factor, self.x), times(factor, self.y), times(factor, self.z))

    def dot(self, other: "Vector") -> Any:
        return add(add(times(self.x, other.x), times(self.y, other.y)), times(self.z, other.z))

    def cross(self, other: "Vector") -> "Vector":
        return Vector(
            subtract(times(self.y, other.z), times(self.z, other.y)),
            subtract(times(self.z, other.x), times(self.x, other.z)),
            subtract(times(self.x, other.y), times(self.y, other.x)),
        )


@struct.dataclass
class Matrix:
    """Three columns."""

    x: Vector
    y: Vector
    z: Vector

    def times(self, vector: Vector) -> Vector:
        return self.x.scaled(vector.x) + self.y.scaled(vector.y) + self.z.scaled(vector.z)

    def transposed_times(self, vector: Vector) -> Vector:
        return Vector(self.x.dot(vector), self.y.dot(vector), self.z.dot(vector))

    def product(self, other: "Matrix") -> "Matrix":
        return Matrix(self.times(other.x), self.times(other.y), self.times(other.z))


@struct.dataclass
class Symmetric:
    """Six components of a symmetric matrix."""

    xx: Any
    xy: Any
    xz: Any
    yy: Any
    yz: Any
    zz: Any

    def __add__(self, other: "Symmetric") -> "Symmetric":
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Symmetric(*(add(one, two) for one, two in pairs))

    def times(self, vector: Vector) -> Vector:
        return self.columns().times(vector)

    def columns(self) -> Matrix:
        return Matrix(
            Vector(self.xx, self.xy, self.xz), Vector(self.xy, self.yy, self.yz), Vector(self.xz, self.yz, self.zz)
        )

    def trace(self) -> Any:
        return add(add(self.xx, self.yy), self.zz)

    def turned(self, rotation: Matrix) -> "Symmetric":
        """R S R^T."""
        half, columns = rotation.product(self.columns()), (rotation.x, rotation.y, rotation.z)
        at = lambda row, column: add(  # noqa: E731
            add(
                times(getattr(half.x, row), getattr(columns[0], column)),
                times(getattr(half.y, row), getattr(columns[1], column)),
            ),
            times(getattr(half.z, row), getattr(columns[2], column)),
        )
        return Symmetric(at("x", "x"), at("x", "y"), at("x", "z"), at("y", "y"), at("y", "z"), at("z", "z"))


def square(vector: Vector, weighted: Vector) -> Symmetric:
    """w v v^T of v and w v."""
    return Symmetric(
        times(weighted.x, vector.x),
        times(weighted.x, vector.y),
        times(weighted.x, vector.z),
        times(weighted.y, vector.y),
        times(weighted.y, vector.z),
        times(weighted.z, vector.z),
    )


def both_ways(a: Vector, b: Vector) -> Symmetric:
    """a b^T + b a^T."""
    xx, yy, zz = times(a.x, b.x), times(a.y, b.y), times(a.z, b.z)
    return Symmetric(
        add(xx, xx),
        add(times(a.x, b.y), times(a.y, b.x)),
        add(times(a.x, b.z), times(a.z, b.x)),
        add(yy, yy),
        add(times(a.y, b.z), times(a.z, b.y)),
        add(zz, zz),
    )


def add(a: Any, b: Any) -> Any:
    """a + b."""
    if _is(a, 0.0):
        return b
    return a if _is(b, 0.0) else a + b


def subtract(a: Any, b: Any) -> Any:
    """a - b."""
    if _is(b, 0.0):
        return a
    return -b if _is(a, 0.0) else a - b


def times(a: Any, b: Any) -> Any:
    """a b."""
    if _is(a, 0.0) or _is(b, 0.0):
        return 0.0
    if _is(a, 1.0):
        return b
    return a if _is(b, 1.0) else a * b


def _is(value: Any, number: float) -> bool:
    return isinstance(value, float) and value == number


ZERO = Vector(0.0, 0.0, 0.0)
IDENTITY = Matrix(Vector(1.0, 0.0, 0.0), Vector(0.0, 1.0, 0.0), Vector(0.0, 0.0, 1.0))
