"""YAML from anybody: plain values of bounded size, or a message with the line at fault."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from driftplan.errors import MapError, TrajectoryError


def read_plain_yaml(path: Path, error: type[MapError] | type[TrajectoryError], *, max_bytes: int) -> Any:
    """What a YAML file holds; anything but plain values, and a larger file, is an ``error``."""
    with path.open("rb") as file:
        text = file.read(max_bytes + 1)
    if len(text) > max_bytes:
        raise error(f"{path}: expected YAML of at most {max_bytes} bytes, got more")
    try:
        return yaml.load(text, _PlainLoader)
    except yaml.MarkedYAMLError as err:
        line = err.problem_mark.line + 1 if err.problem_mark else "?"
        raise error(f"{path}, line {line}: not plain YAML: {err.problem}") from err
    except (yaml.YAMLError, ValueError, RecursionError) as err:
        raise error(f"{path}: not plain YAML: {str(err)[:200]}") from err


class _PlainLoader(yaml.SafeLoader):
    """The safe loader without aliases: a few hundred bytes of them can stand for more than memory holds."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, "aliases have no place in plain YAML", event.start_mark)
        return super().compose_node(parent, index)
