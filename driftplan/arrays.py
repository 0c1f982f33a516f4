"""Names for arrays, the checks of what public functions accept, and vectors of the plane as complex numbers."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Sequence
from functools import wraps
from math import inf, isfinite
from reprlib import repr as short
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftplan.errors import ArgumentError, KeywordError

_Callable = TypeVar("_Callable", bound=Callable[..., Any])

Array = NDArray[Any]  # complex, or float where nothing turns: real pieces cost half
Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]

MAX_NUMBER = 1e13  # metres or anything: of greater ones products overflow
_MIN_POSITIVE = 1e-50


def number(name: str, value: object) -> float:
    """A finite number."""
    if isinstance(value, bool) or not hasattr(value, "__float__") or np.ndim(value) != 0:  # type: ignore[arg-type]
        raise ValueError(f"expected {name} to be a number, got {short(value)}")
    try:
        result = float(value)
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


def instance(name: str, value: object, *classes: type) -> None:
    """Refuse what is an object of none of these classes."""
    if not isinstance(value, classes):
        wanted = " or ".join(c.__name__ for c in classes)
        raise ArgumentError(f"expected {name} to be a{'n' * (wanted[0] in 'AEIOU')} {wanted}, got {short(value)}")


def whole(name: str, value: object, *, least: int) -> int:
    """A whole number >= least."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"expected {name} a whole number >= {least}, got {short(value)}")
    return int(value)


def bounded(what: str, count: float, most: float, remedy: str) -> float:
    """A count of things derived from input, refused before anything is made of it.

    Examples
    --------
    >>> bounded("sites", 1e7, 1e6, "use a larger spacing_m")
    Traceback (most recent call last):
    ValueError: expected at most 1e+06 sites, got 1e+07: use a larger spacing_m
    """
    if not count <= most:
        raise ValueError(f"expected at most {most:g} {what}, got {count:g}: {remedy}")
    return count


def finite(name: str, values: Any, what: str = "numbers", *, most: float = MAX_NUMBER) -> Floats:
    """An array of finite numbers, none greater than ``most``; ``what`` they are, for the message."""
    try:
        array = np.asarray(values, dtype=float)
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


def covariance(name: str, matrix: Any, dimensions: Sequence[int] = (2,)) -> Floats:
    """A covariance matrix of one of these dimensions."""
    array = finite(name, matrix)
    if array.ndim != 2 or array.shape[0] != array.shape[1] or array.shape[0] not in dimensions:
        raise ValueError(
            f"expected {name} a square matrix of dimension {' or '.join(map(str, dimensions))}, got {array.shape}"
        )
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
    bounds = tuple(float(v) for v in value)
    if len(bounds) != 4 or not all(isfinite(v) for v in bounds) or bounds[0] >= bounds[2] or bounds[1] >= bounds[3]:
        raise ValueError(f"expected bounds (xmin, ymin, xmax, ymax), finite and not empty, got {bounds!r}")
    return bounds


def arguments_checked(**values: type | str) -> Callable[[_Callable], _Callable]:
    """A decorator of public functions and dataclasses: an unknown keyword is answered with the nearest known one, and
    what should be one of driftplan's own objects, or a sequence of them, by its annotation, and is not, with what was
    expected.

    ``values`` are parameters that are frozen values: their fields are known names too, and the answer says where they
    go; or, as a string, what is written instead of a keyword that one might expect.

    Examples
    --------
    >>> @arguments_checked()
    ... def wait(time_limit=1.0): ...
    >>> wait(timelimit=3.0)
    Traceback (most recent call last):
    driftplan.errors.KeywordError: wait() has no keyword 'timelimit': did you mean time_limit?
    """

    def decorate(function: _Callable) -> _Callable:
        called = cast(Any, function).__init__ if isinstance(function, type) else function
        signature = inspect.signature(function)
        known = tuple(signature.parameters)
        any_keyword = any(p.kind is p.VAR_KEYWORD for p in signature.parameters.values())
        places = known if not isinstance(function, type) else ("self", *known)
        objects: dict[str, _Object] = {}

        @wraps(called)
        def checked(*args: Any, **given: Any) -> Any:
            if not objects:  # not before the module is complete
                objects.update(_objects_of(signature))
            for name in given:
                if name not in known and not any_keyword:
                    nearest = _nearest(name, known, values)
                    raise KeywordError(f"{function.__name__}() has no keyword {name!r}: {nearest}")
            for name, value in (*zip(places, args, strict=False), *given.items()):
                if name in objects:
                    objects[name].check(name, value)
            return called(*args, **given)

        if isinstance(function, type):
            cast(Any, function).__init__ = checked
            return function
        return cast(_Callable, checked)

    return decorate


_OMPL = ("SpaceInformation", "PathGeometric", "PathControl", "OptimizationObjective")


class _Object(NamedTuple):
    """What an annotation asks for: one of some classes, by their names, or a sequence of them."""

    classes: frozenset[str]
    several: bool

    def check(self, name: str, value: object) -> None:
        wanted = " or ".join(sorted(self.classes - {"NoneType"}))
        if not self.several:
            wanted, wrong = f"a{'n' * (wanted[0] in 'AEIOU')} {wanted}", [] if self._holds(value) else [value]
        elif isinstance(value, (list, tuple)):
            wanted, wrong = f"{wanted} objects", [item for item in value if not self._holds(item)]
        else:
            wanted = f"a sequence of {wanted}"
            wrong = [] if isinstance(value, Sequence) and not isinstance(value, str) else [value]
        if wrong:
            raise ArgumentError(f"expected {name} to be {wanted}, got {short(wrong[0])}")

    def _holds(self, value: object) -> bool:
        return any(c.__name__ in self.classes for c in type(value).__mro__)


def _objects_of(signature: inspect.Signature) -> dict[str, _Object]:
    """The parameters whose annotations name nothing but public classes of driftplan's, some of OMPL's, and None."""
    public = {*sys.modules["driftplan"].__all__, *_OMPL, "None"}
    found = {}
    for name, parameter in signature.parameters.items():
        several, _, annotation = str(parameter.annotation).rpartition("[")
        classes = {part.rpartition(".")[2] for part in annotation.removesuffix("]").split(" | ")}
        if classes - {"None"} and classes <= public and several in ("", "Sequence"):
            found[name] = _Object(frozenset(c.replace("None", "NoneType") for c in classes), bool(several))
    return found


def _nearest(name: str, known: Sequence[str], values: dict[str, type | str]) -> str:
    """What was probably meant, in words."""
    from difflib import get_close_matches

    inside = {
        field: f"{parameter}={value.__name__}({field}=…)"
        for parameter, value in values.items()
        if isinstance(value, type)
        for field in inspect.signature(value).parameters
    }
    inside |= {name: value for name, value in values.items() if isinstance(value, str)}
    places = {**inside, **{own: own for own in known}}
    close = [name] if name in places else get_close_matches(name, places, n=1)
    return f"did you mean {places[close[0]]}?" if close else f"expected {', '.join(known)}"
