"""Docstrings of the project as Markdown, for the reference pages: a griffe extension.

Sections are underlined names, items are ``name : what it is``, anything else is text; a public name in backquotes
becomes a link to its place in the reference.
"""

from __future__ import annotations

import inspect
import re
from typing import Any

import griffe

import driftplan

_ITEM = re.compile(r"^(\*{0,2}\w[\w, |]*) : (.+)$")
_NAME = re.compile(r"(?<![`\[])`(\w+)((?:\.\w+)*)`(?!`)")


def markdown(docstring: str) -> str:
    """A docstring as Markdown.

    >>> print(markdown("Text.\\n\\nParameters\\n----------\\nx : metres\\n    to the right"))
    Text.
    <BLANKLINE>
    **Parameters**
    <BLANKLINE>
    - **x** : metres to the right
    """
    lines = inspect.cleandoc(docstring).splitlines()
    out: list[str] = []
    k = 0
    while k < len(lines):
        line = lines[k]
        if k + 1 < len(lines) and re.fullmatch(r"-{3,}", lines[k + 1]):
            out += [f"**{line}**", ""] if line != "Examples" else [""]
            k += 2
        elif line.startswith(">>>"):
            end = next((j for j in range(k, len(lines)) if not lines[j].strip()), len(lines))
            out += ["```pycon", *lines[k:end], "```"]
            k = end
        elif line.endswith("::"):
            end = next((j for j in range(k + 1, len(lines)) if re.match(r"\S", lines[j])), len(lines))
            out += [line.removesuffix("::").rstrip(), "", "```text", *_dedented(lines[k + 1 : end]), "```", ""]
            k = end
        elif item := _ITEM.match(line):
            end = next((j for j in range(k + 1, len(lines)) if not lines[j].startswith("    ")), len(lines))
            more = [part.strip() for part in lines[k + 1 : end]]
            said = item[2] + (" " if more and more[0][:1].islower() else ". " if more else "") + " ".join(more)
            out.append(f"- **{item[1]}** : {said}" if _begins_list(out) else f"\n- **{item[1]}** : {said}")
            k = end
        else:
            out.append(f"\n{line}" if out and out[-1].lstrip("\n").startswith("- **") and line else line)
            k += 1
    text = re.sub(r"(?<!`)``(?!`)", "`", "\n".join(out))
    return _NAME.sub(_linked, text)


def _begins_list(out: list[str]) -> bool:
    return not out or out[-1] == "" or out[-1].lstrip("\n").startswith("- **")


def _dedented(lines: list[str]) -> list[str]:
    return inspect.cleandoc("\n" + "\n".join(lines)).splitlines()


def _linked(found: re.Match[str]) -> str:
    return f"[{found[0]}][driftplan.{found[1]}]" if found[1] in driftplan.__all__ else found[0]


class Docstrings(griffe.Extension):
    """Rewrites every docstring as it is read."""

    def on_instance(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Of modules, classes, functions and attributes alike."""
        if obj.docstring:
            obj.docstring.value = markdown(obj.docstring.value)
