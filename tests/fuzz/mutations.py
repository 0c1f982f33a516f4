"""Broken files out of good ones: a few changes of bytes, lines, words, numbers or parsed values, by a seed."""

from __future__ import annotations

import json
import random
import re
from typing import Any

NUMBERS = (
    "0", "-1", "-0.0", "1", "2", "0.5", "1e-320", "1e-50", "1e13", "1e14", "1e300", "1e400", "-1e300",
    "nan", "inf", "-.inf", ".nan",
    "NaN", "1_000", "0x10", "1,5", "٣", "", "true", "null", "[1]", "{}", "'1'", "9" * 400, "2147483648",
    "18446744073709551616", "1e", "--1", "~", "1:30", "2001-01-01", "255", "65535", "181", "360",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 3.5, 1e-320, 1e14, 1e300, -1e300, 10**30, "", "x", "1", "Polygon", "Point",
    [], {}, [1], [[]],
    [1, 2], [1, 2, 3], [[1, 2]], [None], {"a": 1}, "é\u2028", "a" * 3000, [[[0, 0], [1, 1], [0, 0]]], [[0, 0]] * 200,
)  # fmt: skip
_BITS = (
    b"\x00",
    b"\xff",
    b"\xef\xbb\xbf",
    b"\r",
    b"\n\n",
    b"\t",
    b",",
    b";",
    b"#",
    b'"',
    b"[" * 300,
    b"&a ",
    b"*a",
    b"<<: ",
    b"- ",
    b" " * 500,
)
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")


def mutated(content: bytes, rng: random.Random, other: bytes) -> bytes:
    """The content with one to four changes; ``other`` is a file to splice in."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        change = rng.choice((_number, _number, _byte, _bit, _cut, _again, _line, _value, _value, _splice))
        content = change(content, rng, other) if content else other
    return content


def _number(content: bytes, rng: random.Random, _: bytes) -> bytes:
    found = list(_NUMBER.finditer(content))
    if not found:
        return content
    at = rng.choice(found)
    return content[: at.start()] + rng.choice(NUMBERS).encode() + content[at.end() :]


def _byte(content: bytes, rng: random.Random, _: bytes) -> bytes:
    at = rng.randrange(len(content))
    return content[:at] + bytes([rng.randrange(256)]) + content[at + 1 :]


def _bit(content: bytes, rng: random.Random, _: bytes) -> bytes:
    at = rng.randrange(len(content) + 1)
    return content[:at] + rng.choice(_BITS) + content[at:]


def _cut(content: bytes, rng: random.Random, _: bytes) -> bytes:
    start, end = sorted(rng.randrange(len(content) + 1) for _ in range(2))
    return rng.choice((content[:start], content[start:], content[:start] + content[end:]))


def _again(content: bytes, rng: random.Random, _: bytes) -> bytes:
    start, end = sorted(rng.randrange(len(content) + 1) for _ in range(2))
    return content[:end] + content[start:end] * rng.choice((1, 2, 20)) + content[end:]


def _line(content: bytes, rng: random.Random, _: bytes) -> bytes:
    lines = content.split(b"\n")
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    if rng.random() < 0.4:
        lines[a], lines[b] = lines[b], lines[a]
    elif rng.random() < 0.5:
        del lines[a]
    else:
        words = re.split(rb"([,; ])", lines[a])
        words[rng.randrange(len(words))] = rng.choice(NUMBERS).encode()
        lines[a] = b"".join(words)
    return b"\n".join(lines)


def _value(content: bytes, rng: random.Random, other: bytes) -> bytes:
    """Something in what JSON or a mapping of YAML holds is another value, lacks, or lies deeper."""
    try:
        whole = json.loads(content)
    except ValueError:
        return _number(content, rng, other)
    places: list[tuple[Any, Any]] = []

    def visit(node: Any) -> None:
        for key in list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ():
            places.append((node, key))
            visit(node[key])

    visit(whole)
    if not places:
        return other
    node, key = rng.choice(places)
    if (chance := rng.random()) < 0.7:
        node[key] = rng.choice(VALUES)
    elif chance < 0.85:
        del node[key]
    elif isinstance(node, dict):
        node[rng.choice(("type", "kind", "id", "extra", "range_m", "crs"))] = node[key]
    else:
        node[key] = [node[key]]
    return json.dumps(whole).encode()


def _splice(content: bytes, rng: random.Random, other: bytes) -> bytes:
    return content[: rng.randrange(len(content) + 1)] + other[rng.randrange(len(other) + 1) :]
