"""Names for arrays, the checks of what public functions accept, and vectors of the plane as complex numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from math import inf, isfinite
from reprlib import repr as short
from typing import Any, Self, SupportsFloat, cast, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftplan.errors import ArgumentError

Array = NDArray[Any]  # complex, or float where nothing turns: real pieces cost half
Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]

MAX_NUMBER = 1e13  # metres or anything: of greater ones products overflow
_MIN_POSITIVE = 1e-50


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Arrays that go together: the fields of a dataclass."""

    def arrays(self) -> tuple[Array, ...]:
        """The arrays, in the order of the attributes."""
        return tuple(getattr(self, field.name) for field in fields(self))

    def __getitem__(self, index: Any) -> Self:
        return type(self)(*(x[index] for x in self.arrays()))

    def numbers(self) -> list[Self]:
        """One by one, in Python's numbers, on which a single operation costs a tenth."""
        return [type(self)(*row) for row in zip(*(np.ravel(x).tolist() for x in self.arrays()), strict=True)]


def is_number(value: object) -> bool:
    if isinstance(value, (np.generic, np.ndarray)):  # which all have a __float__
        return value.ndim == 0 and value.dtype.kind in "iuf" and not np.ma.is_masked(value)
    return hasattr(type(value), "__float__") and not isinstance(value, bool)


def number(name: str, value: object) -> float:
    """A finite number."""
    if not is_number(value):
        raise ValueError(f"expected {name} to be a number, got {short(value)}")
    try:
        result = float(cast(SupportsFloat, value))
    except OverflowError:  # a whole number of 400 digits
        result = inf
    if not isfinite(result):
        raise ValueError(f"expected {name} finite, got {result!r}")
    if abs(result) > MAX_NUMBER:
        raise ValueError(f"expected {name} no greater than {MAX_NUMBER:g}, got {result!r}")
    return result


def not_negative(name: str, value: object) -> float:
    """A finite number >= 0."""
    result = number(name, value)
    if result < 0:
        raise ValueError(f"expected {name} >= 0, got {result!r}")
    return result


def positive(name: str, value: object) -> float:
    """A finite number > 0, and not so small that dividing by it overflows."""
    result = number(name, value)
    if result < _MIN_POSITIVE:
        least = f", {_MIN_POSITIVE:g} at least" if result > 0 else ""
        raise ValueError(f"expected {name} > 0{least}, got {result!r}")
    return result


def seconds(name: str, value: object) -> float:
    """A time > 0, s; infinite where there is no end to it."""
    return inf if isinstance(value, float) and value == inf else positive(name, value)


def instance(name: str, value: object, *classes: type) -> None:
    """Refuse what is an object of none of these classes."""
    if not isinstance(value, classes):
        wanted = " or ".join(c.__name__ for c in classes)
        raise ArgumentError(f"expected {name} to be a{'n' * (wanted[0] in 'AEIOU')} {wanted}, got {short(value)}")


def listener(name: str, value: Any, given: str) -> Callable[..., Any]:
    """What is called with news; for None, what does nothing."""
    if not callable(value) and value is not None:
        raise ArgumentError(f"expected {name} to be called {given}, got {short(value)}: give a function, or None")
    return (lambda *_: None) if value is None else value


def whole(name: str, value: object, *, least: int) -> int:
    """A whole number >= least."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"expected {name} a whole number >= {least}, got {short(value)}")
    return int(value)


def generator(rng: object) -> np.random.Generator:
    """Of random numbers, or of those of a seed."""
    return rng if isinstance(rng, np.random.Generator) else np.random.default_rng(whole("rng a seed:", rng, least=0))


def choice(name: str, value: object, kinds: object) -> None:
    """One of the words of a ``Literal``, which an array is not."""
    if not isinstance(value, str) or value not in get_args(kinds):
        error = ValueError if isinstance(value, str) else ArgumentError
        raise error(f"expected {name} one of {get_args(kinds)}, got {short(value)}")


def bounded(what: str, count: float, most: float, remedy: str) -> float:
    """A count of things derived from input, refused before anything is made of it.

    >>> bounded("sites", 1e7, 1e6, "use a larger spacing_m")
    Traceback (most recent call last):
    ValueError: expected at most 1e+06 sites, got 1e+07: use a larger spacing_m
    """
    if not count <= most:
        raise ValueError(f"expected at most {most:g} {what}, got {min(count, 1e300):g}: {remedy}")
    return count


def finite(name: str, values: Any, what: str = "numbers", *, most: float = MAX_NUMBER) -> Floats:
    """An array of finite numbers, none greater than ``most``; ``what`` they are, for the message."""
    try:
        array = np.asarray(values)
        if array.dtype.kind in "cmM" or np.ma.is_masked(values):
            raise ValueError("complex numbers, times and masked values are none")
        array = array.astype(float, copy=False)
    except (TypeError, ValueError, OverflowError) as err:
        raise ValueError(f"expected {name} to be {what}, got {type(values).__name__}: {err}") from None
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"expected {name} finite, got {array[where]} at index {where}")
    if array.size and np.abs(array).max() > most:
        raise ValueError(f"expected {name} no greater than {most:g}, got {np.abs(array).max():g}")
    return array


def shaped(name: str, values: Any, shape: tuple[int, ...]) -> Floats:
    """An array of finite numbers of exactly this shape."""
    array = finite(name, values)
    if array.shape != shape:
        raise ValueError(f"expected {name} of shape {shape}, got {array.shape}")
    return array


def plane(name: str, values: Any) -> Array:
    """Planar vectors (..., 2) as complex numbers (...)."""
    array = finite(name, values)
    if array.ndim < 1 or array.shape[-1] != 2:
        raise ValueError(f"expected {name} of shape (..., 2), got {array.shape}")
    return np.asarray(array[..., 0] + 1j * array[..., 1])


def covariance(name: str, matrix: Any) -> Floats:
    """A covariance matrix of the plane."""
    array = finite(name, matrix)
    if array.shape != (2, 2):
        raise ValueError(f"expected {name} a square matrix of dimension 2, got {array.shape}")
    if not np.allclose(array, array.T) or np.linalg.eigvalsh(array)[0] < -1e-12 * np.trace(array):
        raise ValueError(f"expected {name} symmetric and positive semi-definite, got {array.tolist()}")
    return array


def as_plane(z: ArrayLike) -> Floats:
    """Complex numbers (...) as planar vectors (..., 2)."""
    return np.stack([np.real(z), np.imag(z)], axis=-1)


def as_covariance(mean: Array, N: Array, e2: Array, u: Array | complex = 1.0) -> Floats:
    """Covariance (..., 2, 2) of u e, for a planar error e with E e, E|e|² and E e² and a rotation u."""
    spread, skew = np.maximum(np.real(N) - np.abs(mean) ** 2, 0.0), u * u * (e2 - mean**2)
    xx, yy, xy = (spread + np.real(skew)) / 2, (spread - np.real(skew)) / 2, np.imag(skew) / 2
    return np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-2)


def points_of(name: str, value: ArrayLike) -> Floats:
    points = finite(name, value, "an array of points (..., 2) in metres")
    if points.ndim < 1 or points.shape[-1] != 2:
        raise ValueError(f"expected {name} to be points (..., 2) in metres, got an array of shape {points.shape}")
    return points


def point_of(name: str, value: ArrayLike) -> tuple[float, float]:
    point = points_of(name, value)
    if point.shape != (2,):
        raise ValueError(f"expected {name} to be one point (2,), got an array of shape {point.shape}")
    return float(point[0]), float(point[1])


def bounds_of(value: Sequence[float]) -> tuple[float, float, float, float]:
    try:
        bounds = tuple(number("a bound", v) for v in value)
    except (TypeError, ValueError):
        bounds = ()
    if len(bounds) != 4 or bounds[0] >= bounds[2] or bounds[1] >= bounds[3]:
        wanted = "bounds (xmin, ymin, xmax, ymax), finite and not empty"
        raise ValueError(f"expected {wanted}, got {bounds or short(value)}")
    return bounds
