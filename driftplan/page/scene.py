"""A scene: a map, routes, odometry and beacons as JSON, which the page in the browser draws and computes with.

Lengths are metres, world frame; angles radians, but for names in ``_deg``. ``examples/guide/studio.md`` lists the keys.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
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
    if world is None:
        everything = shapely.multipoints([*(xy for path in routes for xy in path), *(b.xy for b in beacons)])
        bounds = everything.buffer(1.0).bounds
    else:
        bounds = world.bounds
    of_routes = zip(
        routes, names or [f"route {k}" for k in range(len(routes))], limits or [None] * len(routes), strict=True
    )
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
        "start_fix": None if start_fix is None else _fix(start_fix),
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


def _fix(fix: Fix) -> dict[str, Any]:
    cov = None if fix.position_cov is None else fix.position_cov.tolist()
    chance = fix.detection_probability
    return {"position_cov": cov, "heading_std": fix.heading_std, "detection_probability": chance}
