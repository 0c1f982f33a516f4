"""A study's report as one file for a browser: it needs nothing else, and asks nothing of any network."""

from __future__ import annotations

import base64
import hashlib
import re
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from driftplan.layouts.study.answers import answers_of
from driftplan.layouts.study.run import StudyResult
from driftplan.layouts.study.work import DONE
from driftplan.report.records import json_text
from driftplan.world.world import World

_MOST_ROUTES = 200  # sets of routes that are drawn: they are planned again for that
_PLACES = 3  # of metres, on the map


def study_html(result: StudyResult) -> bytes:
    """The report: what was asked, curves with their spread, what matters most, the layout behind every point, what is
    infeasible and why, predictions against simulated drives, and how to do it again.

    >>> from driftplan import run_study
    >>> study = {"routes": [[[0, 0], [60, 0]]], "noise": {"heading_deg": 2}, "vary": {"seed": [1, 2]}}
    >>> study_html(run_study(study)).startswith(b"<!doctype html>")
    True
    """
    page = Path(__file__).with_suffix(".html").read_text(encoding="utf-8")
    for tag, begin in (("style", "<style>"), ("script", '<script type="module">')):
        code = re.search(rf"{begin}(.*?)</{tag}>", page, re.DOTALL)
        assert code is not None
        page = page.replace(f"@{tag}@", base64.b64encode(hashlib.sha256(code[1].encode()).digest()).decode())
    return page.replace("@data@", json_text(_data(result)).replace("<", "\\u003c")).encode()


def _data(result: StudyResult) -> dict[str, Any]:
    """Everything that the page shows; numbers that are not finite are null."""
    answers, study = answers_of(result), result.study
    places: dict[int, dict[str, Any]] = {}
    routes: dict[int, Any] = {}
    for cell, task in zip(result.cells, result.tasks, strict=True):
        row = result.rows.get(task.key)
        if row is not None and row["outcome"] == DONE:
            driven = result.workshop.routes(task) if len(routes) < _MOST_ROUTES else ()
            routes[id(driven)] = driven
            existing = [[b.id, b.x, b.y] for b in result.inputs.shared[task.sites].existing]
            placed = [[i, x, y] for i, _, x, y, _ in row.get("layout", ())]
            places[cell.number] = {"map": task.world, "routes": id(driven), "existing": existing, "placed": placed}
    for place in places.values():
        place["routes"] = list(routes).index(place["routes"])
    maps = {task.world: result.inputs.shared[task.world] for task in result.tasks if task.world}
    return {
        "title": study.title,
        "version": version("driftplan"),
        "file": "" if study.path is None else study.path.name,
        "text": study.text,
        "answers": asdict(answers),
        "rows": result.to_dicts(),
        "ends": [end for row in result.rows.values() for end in row.get("ends", ())],
        "seconds": sum(row["spent"].get("processor_s", 0.0) for row in result.rows.values()),
        "places": places,
        "routes": [[np.round(route, _PLACES).tolist() for route in one] for one in routes.values()],
        "maps": {name: _drawn(world) for name, world in maps.items() if isinstance(world, World)},
    }


def _drawn(world: World) -> dict[str, Any]:
    """A map as a path of SVG, to a pixel or so, and its bounds."""
    xmin, ymin, xmax, ymax = world.bounds
    walls = shapely.simplify(world.obstacles, max(xmax - xmin, ymax - ymin) / 2000)
    rings = map(shapely.get_coordinates, shapely.get_rings(shapely.get_parts(walls)))
    path = "".join("M" + "L".join(f"{x:g} {y:g}" for x, y in np.round(ring, _PLACES)) + "Z" for ring in rings)
    return {"bounds": world.bounds, "walls": path}
