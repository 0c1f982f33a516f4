"""YAML and JSON from anybody: plain values of bounded size, no key twice, or a message with the line at fault."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from reprlib import repr as short
from typing import TYPE_CHECKING, Any, NoReturn

import yaml

from driftplan.errors import MapError
from driftplan.files import FileError, read_bytes

MAX_YAML_BYTES, MAX_JSON_BYTES = 5_000_000, 50_000_000  # of each a minute's reading at most


def read_yaml(path: Path, error: FileError, *, max_bytes: int = MAX_YAML_BYTES) -> Any:
    """What a YAML file holds, mappings as `Lined`. ``1e-4`` is a number, as in YAML 1.2 and for people."""
    text = read_bytes(path, error, max_bytes=max_bytes)
    try:
        return yaml.load(text, _PlainLoader)
    except yaml.MarkedYAMLError as err:
        line = err.problem_mark.line + 1 if err.problem_mark else "?"
        raise error(f"{path}, line {line}: not plain YAML: {err.problem}") from err
    except (yaml.YAMLError, ValueError, RecursionError) as err:
        raise error(f"{path}: not plain YAML: {' '.join(str(err).split())[:200]}") from err


def read_json(path: Path) -> Any:
    """What a JSON file holds."""
    return json_of(path, read_bytes(path, MapError, max_bytes=MAX_JSON_BYTES))


def json_of(path: Path, text: bytes) -> Any:
    """What JSON text from the file holds."""
    try:
        return json.loads(text.removeprefix(b"\xef\xbb\xbf"), parse_constant=_refuse, object_pairs_hook=_without_twice)
    except json.JSONDecodeError as err:
        raise MapError(f"{path}, line {err.lineno}: not JSON: {err.msg}") from err
    except (ValueError, RecursionError) as err:
        raise MapError(f"{path}: not JSON: {str(err)[:200]}") from err


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number")


def _without_twice(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    known = dict(pairs)
    if len(known) < len(pairs):
        raise ValueError(f"a key occurs twice in {short([key for key, _ in pairs])}")
    return known


class Lined(dict[Any, Any]):
    """A mapping of a file, with the line of every key."""

    lines: dict[Any, int]


if TYPE_CHECKING or not hasattr(yaml, "CSafeLoader"):
    _Loader = yaml.SafeLoader
else:  # libyaml finds the words, three times as fast; PyYAML's own composer still says no where it should

    class _Loader(yaml.composer.Composer, yaml.CSafeLoader):
        def __init__(self, stream):
            yaml.CSafeLoader.__init__(self, stream)
            yaml.composer.Composer.__init__(self)


class _PlainLoader(_Loader):
    """The safe loader without aliases, of which a few hundred bytes can stand for more than memory holds, and without
    keys given twice, of which parsers take the one or the other."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, "aliases have no place in plain YAML", event.start_mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    problem = f"the key {key.value!r} occurs twice"
                    raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
                seen.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_lined(self, node: Any) -> Iterator[Lined]:
        data = Lined()
        yield data
        data.update(self.construct_mapping(node))
        data.lines = {key: n.start_mark.line + 1 for key, (n, _) in zip(data, node.value, strict=False)}


_PlainLoader.add_constructor("tag:yaml.org,2002:map", _PlainLoader.construct_lined)
_PlainLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)[eE][-+]?\d+$"), list("-+0123456789.")
)
