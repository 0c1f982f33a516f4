"""What the words of a scenario stand for: files read, noises and kinds made, each once, and told apart by content."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache, partial
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.beacon_files import load_beacons
from driftplan.errors import DriftplanError, StudyError
from driftplan.layouts.co_design.design import load_trips
from driftplan.layouts.study.study import Cell, Study, Values
from driftplan.model.noise import OdometryNoise
from driftplan.model.presets import PRESETS
from driftplan.model.readings import Fix
from driftplan.planning.request import DriftLimit
from driftplan.world.mapfiles import bundled_map, bundled_maps, load_world
from driftplan.world.noise_files import load_noise
from driftplan.world.route_files import read_path
from driftplan.world.route_graphs import load_graph

_SECTIONS = (  # of a scenario: what is said of it, and its keys
    ("map", ("map", "robot_radius_m", "unknown_is_free", "cell_size_m", "level", "keepout", "zones")),
    ("noise", ("noise",)), ("trips", ("routes", "trips", "graph")), ("sites", ("beacon", "sites", "existing")),
)  # fmt: skip
_SHOWING = ("report", "page", "literature")  # parts of driftplan on which no row depends
_SPREAD = ("heading_deg", "distance_m", "after_m", "heading_deg_per_full_turn")  # of `OdometryNoise.from_std`
_PLAIN: Values = {  # keys whose values a task holds as they are, and what they are unless said
    "limit_m": None, "confidence": None, "redundancy": 1, "estimator": "reset", "max_beacons": None, "budget": None,
    "start": None, "minimise": "length", "seed": 0, "time_limit_s": 60.0, "simulated_drives": 0,
}  # fmt: skip


@dataclass(frozen=True)
class CellTask:
    """A cell for a worker: small, since what cells share is named by its content and sent on its own."""

    number: int
    key: str  # a hash of all that determines the cell, contents of files and driftplan's sources included
    world: str  # like noise, trips and sites a key of `Inputs.shared`
    noise: str
    trips: str
    sites: str
    plain: Values  # the other keys of the scenario


@dataclass(frozen=True)
class Trips:
    """Where routes come from: waypoints (n, 2), ends (2, 2) or ids of nodes, or so many made by chance."""

    routes: tuple[Any, ...] = ()
    ends: tuple[Any, ...] = ()
    graph: Any = None
    random: int = 0
    stops: int = 2


@dataclass(frozen=True)
class SitesAsked:
    """What `Sites` is to be told, as far as it does not depend on routes."""

    kinds: tuple[BeaconKind, ...]
    points: Any
    existing: tuple[Beacon, ...]
    spacing_m: float | None = None
    along: str = "grid"
    min_spacing_m: float = 0.0
    forbidden: tuple[Any, ...] = ()

    @property
    def all_kinds(self) -> tuple[BeaconKind, ...]:
        """The kinds that may be placed, each once."""
        return tuple(dict.fromkeys(self.kinds or [beacon.kind for beacon in self.points]))


class Inputs:
    """What the cells of a study are made of."""

    def __init__(self, study: Study) -> None:
        self.study = study
        self.shared: dict[str, Any] = {}  # by digest: what workers need to have once
        self._folder = study.path.parent if study.path else Path()
        self._known: dict[str, str] = {}

    def task(self, cell: Cell) -> CellTask:
        """What a worker is told of a cell; a StudyError if something named cannot be read or makes no sense."""
        scenario = cell.scenario
        makers = self._world, self._noise, self._trips, self._sites
        parts = tuple(self._digest(*section, scenario, make) for section, make in zip(_SECTIONS, makers, strict=True))
        plain = {key: scenario.get(key, default) for key, default in _PLAIN.items()}
        self._check(scenario, plain)
        text = json.dumps([sources_digest(), parts, plain], sort_keys=True)
        world, noise, trips, sites = parts
        key = hashlib.sha256(text.encode()).hexdigest()[:32]
        return CellTask(cell.number, key, world, noise, trips, sites, plain)

    def _digest(self, section: str, keys: tuple[str, ...], scenario: Values, make: Callable[[Values], Any]) -> str:
        part = {key: scenario[key] for key in keys if key in scenario}
        text = section + json.dumps(part, sort_keys=True)
        if text not in self._known:
            try:
                value = make(part)
            except StudyError:
                raise
            except (DriftplanError, ValueError, TypeError, OSError) as err:
                self.study.place_of(next(iter(part), section)).refuse(str(err))
            self._known[text] = digest(value)
            self.shared[self._known[text]] = value
        return self._known[text]

    def _check(self, scenario: Values, plain: Values) -> None:
        """Combinations that would mean nothing."""
        place = self.study.place_of
        wanted = [key for key in ("limit_m", "max_beacons", "budget") if plain[key] is not None]
        if wanted and "beacon" not in scenario and "file" not in scenario.get("sites", {}):
            place(wanted[0]).refuse("expected the key beacon: what may be placed")
        for key in ("beacon", "sites"):
            if not wanted and key in scenario:
                place(key).refuse("expected limit_m, max_beacons or budget too: without one nothing is placed")
        if plain["estimator"] == "filter" and plain["confidence"] is not None:
            why = "expected confidence only for estimator reset: with a filter limits are on the rms"
            place("confidence").refuse(why)
        DriftLimit(plain["limit_m"], plain["redundancy"], plain["confidence"])

    def _file(self, name: str) -> Path:
        return self._folder / name

    def _world(self, scenario: Values) -> Any:
        if "map" not in scenario:
            if scenario:
                raise ValueError("expected the key map too")
            return None
        name, options = scenario["map"], {key: value for key, value in scenario.items() if key != "map"}
        options |= {key: self._file(options[key]) for key in ("keepout", "zones") if key in options}
        path = bundled_map(name) if name in bundled_maps() else self._file(name)
        return load_world(path, robot_radius=options.pop("robot_radius_m", 0.3), **options)

    def _noise(self, scenario: Values) -> OdometryNoise:
        held = scenario.get("noise")
        if held is None:
            raise ValueError("expected the key noise: a file, a preset, or spreads as in {heading_deg: 2, after_m: 10}")
        held = {"from": held} if isinstance(held, str) else held
        spread = {key: value for key, value in held.items() if key in _SPREAD}
        rates = {key: value for key, value in held.items() if key not in (*_SPREAD, "from")}
        name = held.get("from")
        if name is None:
            straight = {"heading_deg": 0.0, "distance_m": 0.0, "after_m": 10.0, **spread}
            noise = OdometryNoise.from_std(**straight) if spread else OdometryNoise()
        elif spread:
            raise ValueError(f"expected rates beside from, got {next(iter(spread))}")
        elif name in PRESETS:
            noise = PRESETS[name].noise
        elif name and self._file(name).exists():
            noise = load_noise(self._file(name))
        else:
            raise ValueError(f"expected a noise file or a preset, one of {', '.join(PRESETS)}; got {name!r}")
        return replace(noise, **rates)

    def _trips(self, scenario: Values) -> Trips:
        routes, trips = scenario.get("routes", []), scenario.get("trips", [])
        if ("routes" in scenario) == ("trips" in scenario):
            raise ValueError(f"expected routes or trips, got {'both' if routes else 'neither'}")
        if routes:
            if "graph" in scenario:
                raise ValueError("expected a graph only with trips, got routes")
            listed = [routes] if isinstance(routes, str) else routes
            read = [read_path(self._file(r))[:, :2] if isinstance(r, str) else np.array(r, dtype=float) for r in listed]
            return Trips(routes=tuple(read))
        graph = load_graph(self._file(scenario["graph"])) if "graph" in scenario else None
        if isinstance(trips, Mapping):
            if graph is not None:
                raise ValueError("expected ids of nodes for a graph, got random trips")
            return Trips(random=trips["random"], stops=trips.get("stops", 2))
        if isinstance(trips, str):
            trips = [(trip.start, trip.goal) for trip in load_trips(self._file(trips))]
        if {np.ndim(trip) for trip in trips} != {2 if graph is None else 1}:
            raise ValueError("expected trips from place to place, or with a graph from node to node")
        ends = tuple(tuple(map(tuple, trip)) if graph is None else tuple(trip) for trip in trips)
        return Trips(ends=ends, graph=graph)

    def _sites(self, scenario: Values) -> SitesAsked:
        beacons, asked = scenario.get("beacon", []), dict(scenario.get("sites", {}))
        kinds = tuple(map(_kind, [beacons] if isinstance(beacons, Mapping) else beacons))
        existing = load_beacons(self._file(scenario["existing"])) if "existing" in scenario else ()
        points: Any = None
        if "file" in asked:
            if {"spacing_m", "along"} & asked.keys():
                raise ValueError("expected sites from a file, or along and spacing_m to generate them, got both")
            file = self._file(asked.pop("file"))
            with_kinds = file.suffix.lower() in (".geojson", ".json")
            if with_kinds == bool(kinds):
                raise ValueError("expected beacons with kinds in the file of sites (.geojson), or the key beacon")
            points = load_beacons(file) if with_kinds else read_path(file)[:, :2]
        forbidden = tuple(np.array(area, dtype=float) for area in asked.pop("forbidden", ()))
        return SitesAsked(kinds, points, existing, forbidden=forbidden, **asked)


def _kind(kind: Values) -> BeaconKind:
    stds = {key.removesuffix("_deg"): radians(v) for key, v in kind.items() if key.endswith("_std_deg")}
    options = {key: v for key, v in kind.items() if key != "kind" and not key.endswith("_std_deg")} | stds
    made: BeaconKind = getattr(BeaconKind, kind["kind"])(**options)
    return made


def start_fix(fix: Values | None) -> Fix | None:
    """The uncertainty at the start that a scenario describes."""
    if fix is None:
        return None
    heading = radians(fix.get("heading_std_deg", 0.0))
    return Fix.full(0.0, position_std_m=fix.get("position_std_m", 0.0), heading_std=heading)


@cache
def sources_digest() -> str:
    """A hash of the part of driftplan that rows depend on, as it is installed: of two versions, released or in the
    making, that differ in it."""
    top, hasher = Path(__file__).parents[2], hashlib.sha256()
    for file in sorted(top.rglob("*.py")):
        if file.relative_to(top).parts[0] not in _SHOWING:
            hasher.update(f"{file.relative_to(top)}:{file.stat().st_size}:".encode() + file.read_bytes())
    return hasher.hexdigest()[:32]


def digest(value: Any) -> str:
    """A hash of the content of a value: equal for equal ones, on every machine."""
    hasher = hashlib.sha256()
    _feed(hasher.update, value)
    return hasher.hexdigest()[:32]


def _feed(update: Callable[[bytes], None], value: Any) -> None:
    """What a value is, piece by piece, lengths first."""
    tell = partial(_feed, update)
    if isinstance(value, shapely.Geometry):
        tell(shapely.to_wkb(value, byte_order=1))
    elif is_dataclass(value):
        tell([type(value).__name__, *(getattr(value, f.name) for f in fields(value))])
    elif isinstance(value, np.ndarray):
        tell([str(value.dtype.str), list(value.shape), np.ascontiguousarray(value).tobytes()])
    elif isinstance(value, Mapping):
        tell(sorted(value.items()))
    elif isinstance(value, (list, tuple)):
        update(f"[{len(value)}".encode())
        for item in value:
            tell(item)
    elif isinstance(value, bytes):
        update(f"b{len(value)}:".encode() + value)
    elif value is None or isinstance(value, (bool, int, float, str, os.PathLike)):
        tell(f"{type(value).__name__}{value!r}".encode())
    else:
        raise TypeError(f"expected plain values, got {type(value).__name__}")
