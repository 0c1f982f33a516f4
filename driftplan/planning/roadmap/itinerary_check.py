"""The exact drift along a path that counts on beacons: greatest anywhere, with beacons dead, with passes missed;
and why no itinerary keeps a limit: the words of an `InfeasibleError`, for someone who has to do something about it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import BeaconColumns, DetectionChance, chances_listed, chances_of_passes, floor_of
from driftplan.model.drift import Drift, predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Readings
from driftplan.model.worst import worst_rms
from driftplan.planning.request import Reliance, format_least, format_point
from driftplan.world.world import World

if TYPE_CHECKING:
    from driftplan.planning.roadmap.beacon_search import BeaconSearch

ALL_ALIVE = -1
_SURE_HEADING = 1e-6  # rad
_LABELS = 5_000  # of a search that only explains,
_SLACK = 0.05  # and of its labels, as a share of the limit squared


class Verdict(NamedTuple):
    """The worst that can happen on a path."""

    worst: float  # greatest rms anywhere on the way, metres
    end: float  # rms at the end
    dead: int  # which beacon's death makes the worst (or the end) so bad; ALL_ALIVE: none's


@dataclass(frozen=True, eq=False)
class ItineraryCheck:
    """What has to be true of a path; ``min_capture`` 0 of the reliance: all passes count."""

    world: World | None
    noise: OdometryNoise
    reliance: Reliance

    @cached_property
    def _columns(self) -> BeaconColumns:
        return BeaconColumns.of(self.reliance.beacons)

    def relying(self, **changes: Any) -> ItineraryCheck:
        """The check of robots that rely on other things."""
        return replace(self, reliance=replace(self.reliance, **changes))

    def met(self, path: Floats) -> list[int]:
        """Beacons that the path counts on, in the order in which they are first read."""
        found = self._readings(path)
        return list(dict.fromkeys(found.source[np.argsort(found.s_m, kind="stable")].tolist()))

    def drift(self, path: Floats, dead: int = ALL_ALIVE) -> Drift:
        """Drift along a path, with one beacon dead."""
        readings = self._readings(path)
        return self._drift(path, readings[readings.source != dead])

    def captures(self, path: Floats) -> list[DetectionChance]:
        """Every pass and how likely it is, with the readings before it that count."""
        found = self._columns.passes(path, self.world)
        arrival = self._drift(path, self._readings(path)).on_arrival(found.enter)
        return chances_listed(self.reliance.beacons, found, chances_of_passes(path, found, self._columns, arrival))

    def verdict(
        self, path: Floats, limit: float = math.inf, *, by_end: bool = False, first: int = ALL_ALIVE
    ) -> Verdict:
        """The worst over all deaths: the greatest drift on the way or, ``by_end``, at the end.

        Deaths that keep the limit are not told apart once one breaks it: that of ``first`` is looked at first.
        """
        readings = self._readings(path)
        deaths = [ALL_ALIVE]
        if self.reliance.redundancy > 1:
            deaths += list(dict.fromkeys(readings.source.tolist()))
            deaths.sort(key=lambda dead: dead != first)
        verdicts = []
        for dead in deaths:
            drift = self._drift(path, readings[readings.source != dead])
            verdicts.append(Verdict(worst_rms(drift), float(drift.end.rms), dead))
            if verdicts[-1].worst > limit:
                break
        if verdicts[-1].worst > limit:
            return verdicts[-1]
        chosen = max(verdicts, key=lambda v: v.end if by_end else v.worst)
        return Verdict(max(v.worst for v in verdicts), max(v.end for v in verdicts), chosen.dead)

    def _readings(self, path: Floats) -> Readings:
        """The readings that count."""
        passes = self._columns.passes(path, self.world)
        found, of_pass = self._columns.readings_of_passes(path, passes)
        if self.reliance.min_capture == 0 or not len(found):
            return found
        counted = np.ones(len(passes.beacon), dtype=bool)
        while True:  # one reading less is more drift on the way to the next
            kept = found[counted[of_pass]]
            arrival = self._drift(path, kept).on_arrival(passes.enter)
            chances = chances_of_passes(path, passes, self._columns, arrival)
            unsure = np.flatnonzero(counted & (chances < self.reliance.min_capture))
            if not len(unsure):
                return kept
            counted[unsure] = False

    def _drift(self, path: Floats, readings: Readings) -> Drift:
        given, (floor, noises) = self.reliance, floor_of(path, self.noise, self.world)
        fixes = Readings.of([] if given.start_fix is None else [given.start_fix]) + readings
        return predict_drift(floor, noises, fixes=fixes, start_heading=given.start_heading, estimator=given.estimator)


def why_infeasible(search: BeaconSearch, limit: float, longest: float) -> str:
    """What to tell the user when ``search`` found no path."""
    asked = f"no route that keeps the drift under {limit:g} m everywhere" if math.isfinite(limit) else "no route"
    if math.isfinite(longest):
        asked += f" and is no longer than {longest:.4g} m"
    if search.reliance.redundancy > 1:
        asked += ", with any one beacon dead"
    if search.timed_out:
        return f"{asked} was found in time, nor was it ruled out: raise time_limit, or begin with a higher max_drift"
    if search.exhausted:
        return (
            f"{asked} was found among {search.labels} partial routes, nor was it ruled out: begin with a higher "
            "max_drift, or take fewer max_nodes"
        )
    search.max_labels = _LABELS
    accuracy = [b.kind.position_std_m * 2**0.5 for b in search.beacons if b.kind.position_std_m is not None]
    reasons = []
    if search.reliance.start_fix is not None and search.check.drift(search.shortest).moments.N[0].real > limit**2:
        reasons.append("the drift at the start is above it already")
    elif search.reliance.estimator == "filter":  # knows more than any one reading says
        pass
    elif not accuracy:
        reasons.append("no beacon gives a position")
    elif min(accuracy) > limit:
        reasons.append(f"the most accurate beacon leaves an rms error of {min(accuracy):.3g} m itself")
    elif _captures_would_help(search, limit, longest):
        reasons.append(
            "beacons that could hold it would be missed: having drifted, the robot comes within their ranges less "
            f"surely than min_capture={search.reliance.min_capture:g} demands; larger ranges or more beacons would help"
        )
    elif _headings_would_help(search, limit, longest):
        reasons.append(
            "position fixes alone cannot hold it because the heading is never fixed well enough: with beacons that "
            "also fix the heading the limit could be kept"
        )
    place, left = search.nearest
    if left > 0:  # else the graph had a route, which the exact model found too lost
        reasons.append(f"the best attempt gets to {format_point(place)}, {left:.4g} m short of the goal")
        if search.beacons:
            distance = [math.hypot(b.x - place[0], b.y - place[1]) for b in search.beacons]
            k = int(np.argmin(distance))
            name, at = search.beacons[k].id or f"number {k}", format_point(search.beacons[k].xy)
            reasons.append(f"the beacon nearest to that place, {name} at {at}, is {distance[k]:.4g} m away")
    if math.isfinite(limit):
        reasons.append(f"a limit of {format_least(search.worst(search.steadiest(longest)))} can be kept")
    if search.reliance.estimator == "reset" and search.beacons:
        fused = _fusing_would_help(search, limit, longest)
        can, cannot = 'can keep it: estimator="filter"', "was not found to keep it either"
        reasons.append(f"a robot that fuses its readings {can if fused else cannot}")
    return f"{asked} (roadmap of {search.max_nodes} nodes)" + (": " + "; ".join(reasons) if reasons else "")


def _captures_would_help(search: BeaconSearch, limit: float, longest: float) -> bool:
    """Whether the limit could be kept if the robot came within every range as planned."""
    if search.reliance.min_capture == 0:
        return False
    check, search.check = search.check, search.check.relying(min_capture=0.0)
    found = search.any_within(limit, longest, _SLACK)
    search.check = check
    return found is not None


def _headings_would_help(search: BeaconSearch, limit: float, longest: float) -> bool:
    """Whether the limit could be kept if every position fix were a full fix."""
    if all(b.kind.heading_std is not None for b in search.beacons):
        return False
    search.graph(0.0, longest)
    assert search.roadmap is not None
    graph = search.graph_of(search.roadmap, [_full(b) for b in search.beacons])
    return search.walk(graph, limit, longest, max_labels=_LABELS).nodes is not None


def _fusing_would_help(search: BeaconSearch, limit: float, longest: float) -> bool:
    """Whether a robot that fuses its readings is soon found to keep the limit."""
    given = search.space, search.world, search.ends, search.noise, replace(search.reliance, estimator="filter")
    same: dict[str, Any] = {name: getattr(search, name) for name in ("max_nodes", "seed", "stop", "shortest", "known")}
    other = type(search)(*given, **same)
    other.max_labels = _LABELS
    return other.any_within(limit, longest, _SLACK) is not None


def _full(beacon: Beacon) -> Beacon:
    kind = beacon.kind
    if kind.heading_std is not None or kind.position_std_m is None:
        return beacon
    return replace(beacon, kind=replace(kind, heading_std=_SURE_HEADING))
