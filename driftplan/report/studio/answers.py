"""What the page of `driftplan.page` asks of Python, answered in JSON: the fewest beacons, routes, and files that are no
plain text, read and written."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from driftplan.arrays import positive
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.beacon_files import beacons_geojson, load_beacons
from driftplan.errors import DriftplanError, InfeasibleError
from driftplan.files import write_files
from driftplan.layouts.layout import Layout
from driftplan.layouts.layout_files import InstallerRow, layout_building, layout_dxf, layout_html, layout_lif
from driftplan.layouts.place import place_beacons
from driftplan.layouts.scenario import Scenario, Sites
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.page.scene import Scene, beacon_of, beacon_said, zones_of
from driftplan.planning.routes import plan_route
from driftplan.planning.status import Status
from driftplan.report.commands.answer import figure_bytes
from driftplan.report.figures.layouts import layout_figure
from driftplan.report.figures.sheet import layout_pdf
from driftplan.world.route_files import read_path
from driftplan.world.world import World

_OF_BEACONS = (".geojson", ".json", ".lif", ".dxf", ".txt", ".building.yaml")
_WRITERS: dict[str, Callable[[Layout], bytes]] = {
    "beacons.dxf": layout_dxf,
    "layout.lif": layout_lif,
    "sheet.pdf": layout_pdf,
    "table.html": layout_html,
    "layout.svg": lambda layout: figure_bytes(layout_figure(layout), "svg"),
}
_AT_ONCE_S = 0.05  # to plan a first route, while a better one is looked for


@dataclass(frozen=True, kw_only=True)
class Answers:
    """Answers about one world, with ``time_limit`` seconds for a search; the scene that is asked about brings all
    else. ``save`` is where its beacons may be written, None: nowhere. ``building`` is the map, where it is an Open-RMF
    building, and its level."""

    world: World | None
    time_limit: float = 60.0
    save: Path | None = None
    building: tuple[Path, str | None] | None = None
    _worlds: list[tuple[Any, World]] = field(default_factory=list, init=False, repr=False)  # the last floors' world

    def __post_init__(self) -> None:
        positive("time_limit", self.time_limit)

    def answer(self, what: str, question: dict[str, Any], tell: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
        """``{"answer": …}``, or ``{"error": text}``; ``tell`` hears of progress.

        "fewest": beacons; "why": the stretch that cannot be kept; "plan": routes; "save": the beacons to `save`;
        "write": the bytes of a file, each as a character; "read": what the text of a file changes.
        """
        try:
            scene = question["scene"]
            scenario = self._scenario(scene)
            if what in ("fewest", "why"):
                kind = BeaconKind(**question["kind"])
                return {"answer": self._fewest(scene, scenario, kind, tell, why=what == "why")}
            if what == "read":
                kind = BeaconKind(**question["kind"])
                return {"answer": _read(str(question["name"]), str(question["text"]), scene, kind)}
            if what == "write":
                file = self._written(str(question["name"]), _layout(scene, scenario))
                return {"answer": {"bytes": file.decode("latin-1")}}
            if what == "plan" and scenario.world is not None:
                plan = partial(_plan, scenario, _alive(scene), question["start"], question["goal"])
                with suppress(DriftplanError):  # the long search says what is wrong
                    tell(plan(_AT_ONCE_S))
                return {"answer": plan(None)}
            if what == "save" and self.save is not None:
                write_files({self.save: beacons_geojson(_alive(scene))})
                return {"answer": {"message": f"wrote {self.save}"}}
            return {"error": f"expected a question about a map or a file that is there, got {what!r}"}
        except (DriftplanError, ValueError, KeyError, TypeError, OSError) as err:
            return {"error": str(err) or type(err).__name__}

    def _scenario(self, scene: Scene) -> Scenario:
        routes, start = tuple(np.array(route["points"]) for route in scene["routes"]), scene["start_fix"]
        fix = None if start is None else Fix(s_m=0.0, **start)
        noise, world = OdometryNoise(**scene["noise"]), self._on(scene["zones"])
        return Scenario(world, routes, noise, start_fix=fix, estimator=scene["estimator"])

    def _on(self, zones: list[dict[str, Any]]) -> World | None:
        """The world with these floors; the same object for the same floors: a world keeps what was planned on it."""
        if self.world is None:
            return None
        known = self._worlds[:]  # of this question: others may be answered meanwhile
        if not known or known[0][0] != zones:
            self._worlds[:] = known = [(zones, replace(self.world, zones=zones_of({"zones": zones})))]
        return known[0][1]

    def _fewest(
        self, scene: Scene, scenario: Scenario, kind: BeaconKind, tell: Callable[..., None], *, why: bool
    ) -> dict[str, Any]:
        """What is locked or was there before stays, everything else is placed anew; of ``why`` only until it is known
        that the limits can be kept."""
        kept = [one for one in scene["beacons"] if one.get("existing") or one.get("locked")]
        limits = [route["limit_m"] for route in scene["routes"]]
        if None in limits:
            raise ValueError("expected a limit for every route: set the limit of all")
        alive = [beacon_of(one) for one in kept if not one.get("dead")]

        def heard(_: float, cost: float, bound: float) -> None:
            if why and isfinite(cost):
                raise _CanBeKept(f"The limits can be kept, at a cost of {cost:g}; at least {bound:g} is needed.")
            tell({"cost": cost if isfinite(cost) else None, "bound": bound})

        try:
            robot: dict[str, Any] = {"estimator": scenario.estimator, "start_fix": scenario.start_fix}
            asked = (scenario.world, scenario.routes, scenario.noise, limits, _sites(scene, kind, alive))
            found = place_beacons(*asked, time_limit=self.time_limit, progress=heard, **robot)
        except _CanBeKept as err:
            return {"message": str(err)}
        except InfeasibleError as err:
            return {"infeasible": str(err), **({} if err.stretch is None else err.stretch._asdict())}
        words = f"{len(found.beacons)} new, at least {found.lower_bound:g} needed; greatest drift"
        message = f"{words} {found.worst_drift:.3g} m. {found.note}"
        return {"beacons": [*kept, *map(beacon_said, found.beacons)], "proven": found.proven, "message": message}

    def _written(self, name: str, layout: Layout) -> bytes:
        """The file of a layout that has this name."""
        if name == "site.building.yaml" and self.building is not None:
            return layout_building(layout, self.building[0], level=self.building[1])
        if name not in _WRITERS:
            raise ValueError(f"expected {', '.join(_WRITERS)}, or site.building.yaml where that is the map, got {name}")
        return _WRITERS[name](layout)


class _CanBeKept(Exception):
    """A search need not go on."""


def _sites(scene: Scene, kind: BeaconKind, existing: list[Beacon]) -> Sites:
    """The candidates, beacons or places for a kind; a grid where there are none."""
    sites = scene["sites"]
    if sites and "kind" in sites[0]:
        return Sites(points=[*map(beacon_of, sites)], existing=existing)
    return Sites(kind, [(one["x"], one["y"]) for one in sites] or None, existing=existing)


def _layout(scene: Scene, scenario: Scenario) -> Layout:
    """The beacons that are alive, as a layout of which nothing is proven; a limit that they break is no limit of it."""
    new, existing = _alive(scene, existing=False), _alive(scene, existing=True)
    drifts = tuple(scenario.drift(r, (*existing, *new)) for r in range(len(scenario.routes)))
    limits = [route["limit_m"] or 0.0 for route in scene["routes"]]
    return Layout(
        beacons=new,
        existing=existing,
        cost=sum(beacon.kind.cost for beacon in new),
        lower_bound=0.0,
        proven=False,
        status=Status.TIME_LIMIT,
        max_drift=tuple(max(limit, scenario.worst(drift)) for limit, drift in zip(limits, drifts, strict=True)),
        drift_bound=0.0,
        drifts=drifts,
        seconds=0.0,
        scenario=scenario,
    )


def _plan(
    scenario: Scenario, beacons: Sequence[Beacon], start: Any, goal: Any, time_limit: float | None
) -> dict[str, Any]:
    """The route of least drift and the shortest one, with the beacons that are alive."""
    world: Any = scenario.world
    ends, found = (world.nearest_free(start), world.nearest_free(goal)), []
    robot: dict[str, Any] = {"estimator": scenario.estimator, "start_fix": scenario.start_fix}
    route = plan_route(world, *ends, scenario.noise, beacons=beacons, time_limit=time_limit, **robot)
    for name, one in (("least drift", route), ("shortest", route.shortest)):
        if one is not None:
            rms = float(replace(scenario, routes=(one.path,)).drift(0, beacons).end.rms)
            found.append({"name": name, "points": one.path.tolist(), "length_m": one.length, "rms_m": rms})
    return {"routes": found}


def _alive(scene: Scene, *, existing: bool | None = None) -> tuple[Beacon, ...]:
    """The beacons that are not dead; with ``existing`` those that were there before, or the others."""
    living = [one for one in scene["beacons"] if not one.get("dead")]
    return tuple(beacon_of(one) for one in living if existing in (None, bool(one.get("existing"))))


def _read(name: str, text: str, scene: Scene, kind: BeaconKind) -> dict[str, Any]:
    """What a file changes in a scene: its beacons, or one more route. ``kind`` is that of beacons that say none."""
    if text.startswith(",".join(InstallerRow._fields[:4])):
        return {"beacons": _as_built(text, scene, kind)}
    with TemporaryDirectory() as folder:
        file = Path(folder, Path(name).name)
        file.write_text(text, encoding="utf-8")
        try:
            if file.name.lower().endswith(_OF_BEACONS) or "tag_bundles" in text:
                return {"beacons": [*map(beacon_said, load_beacons(file, kind))]}
            points = read_path(file)[:, :2].tolist()
        except DriftplanError as err:
            raise ValueError(str(err).replace(f"{folder}/", "")) from err
    limits = [route["limit_m"] for route in scene["routes"]]
    return {"routes": [*scene["routes"], {"name": name, "points": points, "limit_m": limits[0] if limits else None}]}


def _as_built(text: str, scene: Scene, kind: BeaconKind) -> list[dict[str, Any]]:
    """Beacons of an installers' table, which says where they are: those that the scene knows, by their ids, keep what
    they are; others are of a kind of that name in the scene, or of ``kind``."""
    known, found = {one["id"]: one for one in scene["beacons"]}, []
    kinds = {one["kind"]["name"]: beacon_of(one).kind for one in scene["beacons"]}
    for line, row in enumerate(csv.DictReader(io.StringIO(text)), start=2):
        try:
            own = known.get(row["id"])
            of_kind = kinds.get(row["kind"], kind) if own is None else beacon_of(own).kind
            facing = float(row["facing_deg"]) if row["facing_deg"] else None
            beacon = Beacon(of_kind, float(row["x_m"]), float(row["y_m"]), id=row["id"], facing_deg=facing)
        except (KeyError, TypeError, ValueError) as err:
            raise ValueError(f"line {line}: expected a row of an installers' table: {err}") from err
        kept = {key: own[key] for key in ("locked", "dead") if key in own} if own else {}
        found.append({**beacon_said(beacon, existing=row.get("new") == "False"), **kept})
    return found
