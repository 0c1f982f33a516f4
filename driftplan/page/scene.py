"""A scene: a map, routes, odometry and beacons as JSON, which the page in the browser draws and computes with; and the
page as one file that needs nothing else: it can be mailed, opened from a disk, and sends nothing anywhere.

Lengths are metres, world frame; angles radians, but for names in ``_deg``. ``examples/guide/studio.md`` lists the keys.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from string import Template
from typing import Any

import shapely
from shapely import MultiPolygon

from driftplan.arrays import Floats, choice
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.model.noise import OdometryNoise, check_continuous
from driftplan.model.readings import Estimator, Fix
from driftplan.world.world import World
from driftplan.world.zones import Zone, noises_on

Scene = dict[str, Any]
_MODULES = (  # each after those that it imports
    *("moments", "elements", "estimators", "passes", "drift", "calculator", "session", "files", "handover"),
    *("colours", "dom", "map", "chart", "panel", "studio", "host"),
)
_IMPORT, _EXPORT = re.compile(r"^import [^;]*;\n", re.MULTILINE), re.compile(r"^export (?!default)", re.MULTILINE)
_MAX_POSITIONS = 400_000  # of walls: 20 MB of JSON, and a second for a browser to draw


def scene_of(
    world: World | None,
    routes: Sequence[Floats],
    noise: OdometryNoise,
    *,
    beacons: Sequence[Beacon] = (),
    existing: Sequence[Beacon] = (),
    limits: Sequence[float | None] | None = None,
    names: Sequence[str] | None = None,
    estimator: Estimator = "reset",
    start_fix: Fix | None = None,
    title: str = "driftplan",
    notes: Sequence[str] = (),
) -> Scene:
    """The scene of checked things; ``limits`` in metres and ``names`` one per route.

    >>> import numpy as np
    >>> scene_of(None, [np.array([[0.0, 0.0], [9.0, 4.0]])], OdometryNoise(heading_var_per_m=1e-4))["bounds"]
    [-1.0, -1.0, 10.0, 5.0]
    """
    choice("estimator", estimator, Estimator)
    zones = world.zones if world is not None else ()
    check_continuous(noises_on(world, noise))
    walls = [] if world is None else _polygons(world.opaque.area)
    if sum(len(ring) for rings in walls for ring in rings) > _MAX_POSITIONS:
        raise ValueError(f"expected walls of at most {_MAX_POSITIONS} positions on a page; simplify the map")
    drawn = [*(xy for path in routes for xy in path), *(beacon.xy for beacon in beacons)]
    bounds = shapely.multipoints(drawn).buffer(1.0).bounds if world is None else world.bounds
    fix = start_fix and {k: getattr(start_fix, k) for k in ("position_cov", "heading_std", "detection_probability")}
    if fix and fix["position_cov"] is not None:
        fix["position_cov"] = fix["position_cov"].tolist()
    named = names or [f"route {k}" for k in range(len(routes))]
    of_routes = zip(routes, named, limits or [None] * len(routes), strict=True)
    return {
        "version": 1,
        "title": title,
        "bounds": list(bounds),
        "walls": walls,
        "zones": [{"polygons": _polygons(zone.polygon), "noise": _rates(zone.noise)} for zone in zones],
        "noise": _rates(noise),
        "routes": [{"name": name, "points": path.tolist(), "limit_m": limit} for path, name, limit in of_routes],
        "beacons": [*(beacon_said(one, existing=True) for one in existing), *map(beacon_said, beacons)],
        "sites": [],
        "estimator": estimator,
        "start_fix": fix,
        "notes": list(notes),
    }


def beacon_said(beacon: Beacon, *, existing: bool = False) -> dict[str, Any]:
    """A beacon as a scene has it."""
    kind = {key: value for key, value in asdict(beacon.kind).items() if value is not None}
    place = {"id": beacon.id, "x": beacon.x, "y": beacon.y, "facing_deg": beacon.facing_deg}
    return {**place, "existing": existing, "kind": kind}


def beacon_of(held: dict[str, Any]) -> Beacon:
    """A beacon of a scene."""
    return Beacon(BeaconKind(**held["kind"]), held["x"], held["y"], id=str(held["id"]), facing_deg=held["facing_deg"])


def zones_of(scene: Scene) -> tuple[Zone, ...]:
    """The floors of a scene."""
    return tuple(
        Zone(MultiPolygon([(rings[0], rings[1:]) for rings in zone["polygons"]]), OdometryNoise(**zone["noise"]))
        for zone in scene["zones"]
    )


def _polygons(area: Any) -> list[list[list[list[float]]]]:
    parts = [part for part in shapely.get_parts(area) if not part.is_empty]
    return [[shapely.get_coordinates(ring).tolist() for ring in shapely.get_rings(part)] for part in parts]


def _rates(noise: OdometryNoise) -> dict[str, float]:
    return {key: value for key, value in asdict(noise).items() if value and isinstance(value, float)}


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
