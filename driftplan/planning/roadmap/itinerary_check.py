"""The exact drift along a path that counts on beacons: greatest anywhere, with beacons dead, with passes missed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from driftplan.arrays import Floats
from driftplan.beacons.readings import (
    BeaconColumns,
    DetectionChance,
    chances_listed,
    chances_of_passes,
    floor_of,
    readings_of_passes,
)
from driftplan.model.drift import Drift, predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Readings
from driftplan.model.worst import worst_rms
from driftplan.planning.request import Reliance
from driftplan.world.world import World

ALL_ALIVE = -1


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

    def verdict(self, path: Floats, limit: float = math.inf, *, by_end: bool = False) -> Verdict:
        """The worst over all deaths: the greatest drift on the way or, ``by_end``, at the end.

        Deaths that keep the limit are not told apart once one breaks it.
        """
        readings = self._readings(path)
        deaths = [ALL_ALIVE]
        if self.reliance.redundancy > 1:
            deaths += list(dict.fromkeys(readings.source.tolist()))
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
        found, of_pass = readings_of_passes(path, passes, self._columns)
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
