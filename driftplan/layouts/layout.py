"""Layout: beacons, what they cost, what is proven about them, and how each of them matters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.passes import passes_of
from driftplan.beacons.readings import BeaconColumns, drift_with_beacons
from driftplan.layouts.placement.covering import Outcome
from driftplan.layouts.placement.drives import Layouts, drives_of, worst_squares
from driftplan.layouts.placement.spans import Spans
from driftplan.layouts.placement.tracks import Tracks, lay_tracks
from driftplan.model.drift import Drift, PointDrift
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.model.worst import worst_radius, worst_rms
from driftplan.world.world import World

_ROUTES_AT_ONCE = 50  # with all their deaths: more would take in memory


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """What a layout is for."""

    world: World | None
    routes: tuple[Floats, ...]
    noise: OdometryNoise
    start_fix: Fix | None = None
    confidence: float | None = None
    redundancy: int = 1

    def drift(self, route: int, beacons: Sequence[Beacon]) -> Drift:
        """Drift along one route with the given beacons alive."""
        fixes = () if self.start_fix is None else (self.start_fix,)
        return drift_with_beacons(self.routes[route], self.noise, beacons, self.world, fixes=fixes)

    def score(self, drift: PointDrift) -> Floats:
        """The score that limits are about: rms, or the radius at the task's confidence."""
        return drift.rms if self.confidence is None else drift.radius(self.confidence)

    def worst(self, drift: Drift) -> float:
        """Greatest score anywhere along a route, metres: `worst_rms`, or `worst_radius` at the task's confidence."""
        return worst_rms(drift) if self.confidence is None else worst_radius(drift, self.confidence)

    def met(self, beacons: Sequence[Beacon], route: int) -> list[Beacon]:
        """Those of the beacons that a route meets."""
        columns = BeaconColumns.of(beacons)
        found = passes_of(self.routes[route], columns.xy, columns.range_m, columns.must_see, self.world)
        return [beacons[i] for i in np.unique(found.beacon)]

    def tracks(self, beacons: Sequence[Beacon], least_limit_m: float) -> Tracks:
        """The routes with the readings of these beacons only."""
        return lay_tracks(
            self.routes, self.noise, beacons, self.world, start_fix=self.start_fix, least_limit_m=least_limit_m
        )

    def worst_of_failures(self, beacons: Sequence[Beacon], least_limit_m: float) -> Floats:
        """Greatest score on every route with the worst set of at most redundancy - 1 dead beacons, metres."""
        if self.confidence is not None:
            routes = range(len(self.routes))
            return np.array([max(self.worst(drift) for _, drift in self.failures(beacons, r)) for r in routes])
        tracks, worst = self.tracks(beacons, least_limit_m), np.zeros(len(self.routes))
        spans, everyone = Spans(tracks), np.ones(len(beacons), dtype=bool)
        for some in np.array_split(np.arange(len(self.routes)), -(-len(self.routes) // _ROUTES_AT_ONCE)):
            drives = drives_of(tracks, everyone, some, self.redundancy)
            np.maximum.at(worst, drives.route, np.sqrt(worst_squares(spans, drives)))
        return worst

    def failures(self, beacons: Sequence[Beacon], route: int) -> Iterator[tuple[tuple[Beacon, ...], Drift]]:
        """Every set of at most redundancy - 1 dead beacons on a route, and the drift without them."""
        met = self.met(beacons, route)
        for dead in range(self.redundancy):
            for gone in combinations(met, dead):
                yield gone, self.drift(route, [b for b in met if b not in gone])


class Importance(NamedTuple):
    """What one beacon does."""

    beacon: Beacon
    routes: tuple[int, ...]  # that meet it
    worst_if_dead: float  # greatest drift on any of them without it, metres (nan if no route meets it)
    worst_route: int  # where that is; -1 if no route meets it


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """Result of `driftplan.layouts.placement.place.place_beacons`.

    Attributes
    ----------
    beacons : tuple of Beacon
        Those to be installed, in the order of the candidates.
    existing : tuple of Beacon
        Those that were there.
    cost : float
        Of `beacons`.
    lower_bound : float
        No layout that keeps the limit costs less.
    proven : bool
        Whether the layout is proven to be the best: for a limit, `cost` equals `lower_bound`; for a budget, the worst
        drift is within the tolerance of `drift_bound`.
    status : Outcome
    max_drift : tuple of float, metres
        The limit of every route.
    drift_bound : float
        For a budget: no layout within it has a smaller worst drift, metres. For a limit: 0.
    drifts : tuple of Drift
        One per route, all beacons alive.
    seconds : float
    task : Task
    """

    beacons: tuple[Beacon, ...]
    existing: tuple[Beacon, ...]
    cost: float
    lower_bound: float
    proven: bool
    status: Outcome
    max_drift: tuple[float, ...]
    drift_bound: float
    drifts: tuple[Drift, ...]
    seconds: float
    task: Task

    def __repr__(self) -> str:
        """What a person would want to know, not pages of moments."""
        return (
            f"Layout({len(self.beacons)} beacons of cost {self.cost:g}, at least {self.lower_bound:g}, "
            f"{'proven' if self.proven else 'not proven'}, {len(self.drifts)} routes, "
            f"worst drift {self.worst_drift:.4g} m)"
        )

    @property
    def gap(self) -> float:
        """How much dearer than `lower_bound`, as a share of the cost."""
        return 0.0 if self.cost <= self.lower_bound else (self.cost - self.lower_bound) / self.cost

    @cached_property
    def worst_drifts(self) -> tuple[float, ...]:
        """Greatest drift on every route, all beacons alive, metres (rms, or the radius at the task's confidence)."""
        return tuple(self.task.worst(drift) for drift in self.drifts)

    @property
    def worst_drift(self) -> float:
        """Greatest drift on any route, all beacons alive, metres."""
        return max(self.worst_drifts)

    @cached_property
    def importance(self) -> tuple[Importance, ...]:
        """For every beacon, old and new: the routes that meet it and the worst drift without it."""
        everyone = (*self.existing, *self.beacons)
        met = [self.task.met(everyone, r) for r in range(len(self.task.routes))]
        pairs = [(beacon, r) for beacon in everyone for r, here in enumerate(met) if beacon in here]
        if self.task.confidence is None:
            hurt = self._worst_rms_without(everyone, pairs)
        else:
            left = ([b for b in met[r] if b != beacon] for beacon, r in pairs)
            hurt = [self.task.worst(self.task.drift(r, some)) for (_, r), some in zip(pairs, left, strict=True)]
        found = []
        for beacon in everyone:
            without = {r: w for (dead, r), w in zip(pairs, hurt, strict=True) if dead == beacon}
            worst = max(without, key=lambda r: without[r], default=-1)
            found.append(Importance(beacon, tuple(without), without.get(worst, float("nan")), worst))
        return tuple(found)

    def _worst_rms_without(self, everyone: Sequence[Beacon], pairs: Sequence[tuple[Beacon, int]]) -> list[float]:
        """Greatest rms on a route without one beacon, for pairs of a beacon and a route that meets it, all at once."""
        if not pairs:
            return []
        tracks = self.task.tracks(everyone, min(self.max_drift))
        number = {beacon: k for k, beacon in enumerate(everyone)}
        alive = [tracks.events_of(r) for _, r in pairs]
        events = [np.arange(here.start, here.stop) for here in alive]
        events = [e[tracks.site[e] != number[b]] for e, (b, _) in zip(events, pairs, strict=True)]
        drive = np.repeat(np.arange(len(pairs)), [len(e) for e in events])
        layouts = Layouts(np.array([r for _, r in pairs]), drive, np.concatenate(events).astype(np.intp))
        return [float(x) for x in np.sqrt(worst_squares(Spans(tracks), layouts))]
