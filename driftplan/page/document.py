"""The page as one file that needs nothing else: it can be mailed, opened from a disk, and sends nothing anywhere."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from pathlib import Path
from string import Template

from driftplan.page.scene import Scene

_MODULES = (  # each after those that it imports
    *("moments", "elements", "estimators", "passes", "drift", "calculator", "session", "files", "handover"),
    *("colours", "dom", "map", "chart", "panel", "studio", "host"),
)
_IMPORT, _EXPORT = re.compile(r"^import [^;]*;\n", re.MULTILINE), re.compile(r"^export (?!default)", re.MULTILINE)


def script() -> str:
    """The page's modules as one: their imports of each other are left out."""
    return "\n".join(_EXPORT.sub("", _IMPORT.sub("", _file(f"{name}.js"))) for name in _MODULES)


def style() -> str:
    """The style sheet."""
    return _file("studio.css")


def page(scene: Scene, *, asks: bool = False, saves: bool = False) -> bytes:
    """The page of a scene. It may ask nobody or, with ``asks``, the server that sent it, which may keep (``saves``)
    what was edited.

    Nothing of the scene is ever read as HTML: it stands there as JSON without a ``<``. The page's own rules
    (Content-Security-Policy) let it run its own script only, and load nothing.
    """
    code = f"{script()}\nopen({json.dumps({'asks': asks, 'saves': saves})});\n"
    filled = Template(_file("studio.html")).substitute(
        script=code,
        script_hash=_hash(code),
        style=style(),
        style_hash=_hash(style()),
        connect="'self'" if asks else "'none'",
        scene=json.dumps(scene, allow_nan=False).replace("<", "\\u003c"),
    )
    return filled.encode()


def _file(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
