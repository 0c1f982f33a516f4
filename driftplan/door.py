"""The door of the house: what is called by its public name is asked for what its annotations promise."""

from __future__ import annotations

import inspect
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from functools import cache, wraps
from reprlib import repr as short
from typing import Any, NamedTuple, cast

import numpy as np

from driftplan.arrays import is_number
from driftplan.errors import ArgumentError, KeywordError

_FORMER = {"start_heading": ("start", "start=(x, y, heading)")}  # where what was a keyword of its own has gone


@cache
def with_door(value: Any) -> Any:
    """A public function as it is called from outside; a class gets its door in place, constructors of other names too.

    An unknown keyword is answered with the nearest known one, in words that say where it goes if it is a field of one
    of driftplan's own objects. What is not what its annotation asks for (a number, a text, one of driftplan's objects,
    a sequence of these) is answered with what was expected. What driftplan calls itself passes no door.
    """
    if inspect.isfunction(value):
        checked = _checked(value, value, value.__name__, 0)
        checked.__module__ = "driftplan"  # where `pickle` finds it
        return checked
    if isinstance(value, type) and not issubclass(value, BaseException):
        for name, made in list(vars(value).items()):
            if isinstance(made, classmethod) and not name.startswith("_"):
                function = made.__func__
                setattr(value, name, classmethod(_checked(function, function, f"{value.__name__}.{name}", 0)))
        if inspect.isfunction(vars(value).get("__init__")):
            setattr(value, "__init__", _checked(vars(value)["__init__"], value, value.__name__, 1))  # noqa: B010
    return value


def _checked(called: Any, asked: Any, title: str, unnamed: int) -> Any:
    """A callable behind its door: ``asked`` has the signature, without the first ``unnamed`` of what is passed."""
    parameters = inspect.signature(asked).parameters
    kinds = {name: _wanted(str(parameter.annotation)) for name, parameter in parameters.items()}
    names, places = ["self"] * unnamed + list(kinds), [(), *kinds.values()][1 - unnamed :]
    any_keyword = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())

    @wraps(called)
    def checked(*args: Any, **given: Any) -> Any:
        for name, wanted, value in zip(names, places, args, strict=False):
            if wanted:
                _check(name, value, wanted)
        for name, value in given.items():
            if name not in kinds and not any_keyword:
                raise KeywordError(f"{title}() has no keyword {name!r}: {_nearest(name, parameters)}")
            if kinds.get(name):
                _check(name, value, kinds[name])
        return called(*args, **given)

    return checked


class _Wanted(NamedTuple):
    """What one part of an annotation asks for, in words, and whether a value is that."""

    one: str
    many: str
    holds: Callable[[Any], bool]
    items: tuple[_Wanted, ...] = ()  # what may be in a sequence or mapping


_PLAIN = {
    "int": _Wanted("a whole number", "whole numbers", lambda value: is_number(value) and hasattr(value, "__index__")),
    "None": _Wanted("", "", lambda value: value is None),
    "float": _Wanted("a number", "numbers", is_number),
    "bool": _Wanted("True or False", "True or False", lambda value: isinstance(value, (bool, np.bool_))),
    "str": _Wanted("a str", "strs", lambda value: isinstance(value, str)),
    "os.PathLike[str]": _Wanted("a Path", "Paths", lambda value: isinstance(value, os.PathLike)),
}
_OTHERS = {"Axes", "Figure", "Generator", "Mark", "SegmentCheck"}
_OTHERS |= {"OptimizationObjective", "PathControl", "PathGeometric", "SpaceInformation"}
_PART = re.compile(r"(?:[^|\[\]]|\[(?:[^\[\]]|\[[^\[\]]*\])*\])+")


@cache
def _wanted(annotation: str) -> tuple[_Wanted, ...]:
    """What a parameter may be, by its annotation; nothing if some part of that is not known here."""
    if annotation in ("int", "int | None"):  # which have bounds, and are asked for with them where they are used
        return ()
    parts = [_part(part.strip()) for part in _PART.findall(annotation)]
    return tuple(part for part in parts if part) if all(parts) else ()


def _part(annotation: str) -> _Wanted | None:
    if annotation in _PLAIN:
        return _PLAIN[annotation]
    name = annotation.rpartition(".")[2]
    if name in _OTHERS or name in sys.modules["driftplan"].__all__:  # told by its name: it may not be imported yet
        return _Wanted(_a(name), f"{name} objects", lambda value: name in _names(cast(Any, type(value))))
    if match := re.fullmatch(r"(Sequence|Iterable|Mapping)\[(?:str, )?(.*)\]", annotation):
        kinds: Any = {"Sequence": (Sequence, np.ndarray), "Iterable": Iterable, "Mapping": Mapping}[match[1]]
        items = _wanted(match[2]) if match[1] != "Iterable" else ()  # which might be gone when looked at
        said = _a(match[1].lower()) + f" of {_words(items, many=True)}" * bool(items)
        return _Wanted(said, said, lambda value: isinstance(value, kinds) and not _is_one(value), items)
    return None


@cache
def _names(kind: type) -> frozenset[str]:
    return frozenset(base.__name__ for base in kind.__mro__)


def _is_one(value: Any) -> bool:
    return isinstance(value, (str, bytes)) or getattr(value, "ndim", 1) == 0


def _a(name: str) -> str:
    return f"a{'n' * (name[0] in 'AEIOi')} {name}"


def _words(wanted: Iterable[_Wanted], *, many: bool = False) -> str:
    return " or ".join(filter(None, (part.many if many else part.one for part in wanted)))


def _check(name: str, value: Any, wanted: tuple[_Wanted, ...]) -> None:
    for part in wanted:
        if part.holds(value):
            break
    else:
        raise ArgumentError(f"expected {name} to be {_words(wanted)}, got {short(value)}")
    for item in (value.values() if isinstance(value, Mapping) else value) if part.items else ():
        if not any(kind.holds(item) for kind in part.items):
            raise ArgumentError(f"expected {name} to be {_words(part.items, many=True)}, got {short(item)}")


def _nearest(name: str, parameters: Mapping[str, inspect.Parameter]) -> str:
    """What was probably meant, in words."""
    public = sys.modules["driftplan"]
    places = {former: said for former, (place, said) in _FORMER.items() if place in parameters}
    for own, parameter in parameters.items():
        for part in re.findall(r"\w+", str(parameter.annotation)):
            if part in public.__all__ and hasattr(getattr(public, part), "__dataclass_fields__"):
                fields = inspect.signature(getattr(public, part)).parameters
                places = {field: f"{own}={part}({field}=…)" for field in fields} | places
    places |= {own: own for own in parameters}
    close = [name] if name in places else get_close_matches(name, places, n=1)
    return f"did you mean {places[close[0]]}?" if close else f"expected {', '.join(parameters)}"
