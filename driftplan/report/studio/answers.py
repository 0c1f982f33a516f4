"""What the page of `driftplan.page` asks of Python, answered in JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from driftplan.arrays import positive
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.beacon_files import beacons_geojson
from driftplan.errors import DriftplanError, InfeasibleError
from driftplan.files import write_files
from driftplan.layouts.layout import Layout
from driftplan.layouts.place import place_beacons
from driftplan.layouts.scenario import Scenario
from driftplan.layouts.sites import Sites
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.page.scene import Scene, beacon_of, beacon_said, zones_of
from driftplan.planning.routes import plan_route
from driftplan.planning.status import Status
from driftplan.report.studio.exchange import read, written
from driftplan.world.world import World

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
                return {
                    "answer": self._fewest(scene, scenario, BeaconKind(**question["kind"]), tell, why=what == "why")
                }
            if what == "read":
                kind = BeaconKind(**question["kind"])
                return {"answer": read(str(question["name"]), str(question["text"]), scene, kind)}
            if what == "write":
                file = written(str(question["name"]), _layout(scene, scenario), self.building)
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
            world, sites, robot = scenario.world, _sites(scene, kind, alive), _robot(scenario)
            found = place_beacons(
                world,
                scenario.routes,
                scenario.noise,
                limits,
                sites,
                time_limit=self.time_limit,
                progress=heard,
                **robot,
            )
        except _CanBeKept as err:
            return {"message": str(err)}
        except InfeasibleError as err:
            return {"infeasible": str(err), **({} if err.stretch is None else err.stretch._asdict())}
        words = f"{len(found.beacons)} new, at least {found.lower_bound:g} needed; greatest drift"
        beacons, message = [*kept, *map(beacon_said, found.beacons)], f"{words} {found.worst_drift:.3g} m. {found.note}"
        return {"beacons": beacons, "proven": found.proven, "message": message}


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


def _robot(scenario: Scenario) -> dict[str, Any]:
    return {"estimator": scenario.estimator, "start_fix": scenario.start_fix}


def _plan(
    scenario: Scenario, beacons: Sequence[Beacon], start: Any, goal: Any, time_limit: float | None
) -> dict[str, Any]:
    """The route of least drift and the shortest one, with the beacons that are alive."""
    world: Any = scenario.world
    ends, found = (world.nearest_free(start), world.nearest_free(goal)), []
    route = plan_route(world, *ends, scenario.noise, beacons=beacons, time_limit=time_limit, **_robot(scenario))
    for name, one in (("least drift", route), ("shortest", route.shortest)):
        if one is not None:
            rms = float(replace(scenario, routes=(one.path,)).drift(0, beacons).end.rms)
            found.append({"name": name, "points": one.path.tolist(), "length_m": one.length, "rms_m": rms})
    return {"routes": found}


def _alive(scene: Scene, *, existing: bool | None = None) -> tuple[Beacon, ...]:
    """The beacons that are not dead; with ``existing`` those that were there before, or the others."""
    living = [one for one in scene["beacons"] if not one.get("dead")]
    return tuple(beacon_of(one) for one in living if existing in (None, bool(one.get("existing"))))
