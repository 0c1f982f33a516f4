"""The exact drift along a path that counts on beacons: greatest anywhere, with beacons dead, with passes missed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon, BeaconColumns, Readings, floor_of, readings_on
from driftplan.beacons.capture import Capture
from driftplan.beacons.passes import Passes, passes_of
from driftplan.model.drift import Drift, PointDrift, predict_drift
from driftplan.model.fixes import Fix
from driftplan.model.noise import OdometryNoise
from driftplan.planning.itinerary.course import Course, ReadingLaws, follow
from driftplan.world.world import World

ALL_ALIVE = -1
_QUANTILES = 24  # of the error per principal axis, when captures are estimated
_WINDOW = 4.0  # how many rms errors beside its pass a robot may be and still be looked for


class Verdict(NamedTuple):
    """The worst that can happen on a path."""

    worst: float  # greatest rms anywhere on the way, metres
    end: float  # rms at the end
    dead: int  # which beacon's death makes the worst (or the end) so bad; ALL_ALIVE: none's


@dataclass(frozen=True, eq=False)
class ItineraryCheck:
    """What has to be true of a path.

    Parameters
    ----------
    redundancy : int
        2: with any one beacon dead too.
    min_capture : float
        Passes that happen less surely than this do not count; 0: all do.
    """

    world: World | None
    noise: OdometryNoise
    beacons: tuple[Beacon, ...]
    initial: Fix | None = None
    start_heading: float | None = None
    redundancy: int = 1
    min_capture: float = 0.0
    _columns: BeaconColumns = field(init=False, repr=False)
    _laws: ReadingLaws = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_columns", BeaconColumns.of(self.beacons))
        object.__setattr__(self, "_laws", ReadingLaws(self.beacons))

    def met(self, path: Floats) -> list[int]:
        """Beacons that the path counts on, in the order in which they are first read."""
        found = self._readings(path)
        return list(dict.fromkeys(found.beacon[np.argsort(found.s_m, kind="stable")].tolist()))

    def drift(self, path: Floats, dead: int = ALL_ALIVE) -> Drift:
        """Drift along a path, with one beacon dead."""
        readings = self._readings(path)
        fixes = [] if self.initial is None else [self.initial]
        for k in np.lexsort((readings.rank, readings.s_m)).tolist():
            site = int(readings.beacon[k])
            if site != dead:
                position, heading = self.beacons[site].kind.position_std_m, self.beacons[site].kind.heading_std
                fixes.append(
                    Fix(
                        s_m=float(readings.s_m[k]),
                        position_cov=None if position is None else position**2 * np.eye(2),
                        heading_std=heading,
                        detection_probability=float(readings.chance[k]),
                    )
                )
        floor, noises = floor_of(path, self.noise, self.world)
        return predict_drift(floor, noises, fixes=fixes, start_heading=self.start_heading)

    def captures(self, path: Floats) -> list[Capture]:
        """Every pass and how likely it is, with the readings before it that count."""
        if not self.beacons:
            return []
        found = self._passes(path)
        chance = self._captured(path, found, self._course(path, self._readings(path)).arrival(found.enter))
        meetings = zip(found.enter.tolist(), found.leave.tolist(), found.beacon.tolist(), chance.tolist(), strict=True)
        return [Capture(self.beacons[i], enter, leave, p) for enter, leave, i, p in sorted(meetings)]

    def verdict(self, path: Floats, limit: float = math.inf, *, by_end: bool = False) -> Verdict:
        """The worst over all deaths: the greatest drift on the way or, ``by_end``, at the end.

        Deaths that keep the limit are not told apart once one breaks it.
        """
        readings = self._readings(path)
        deaths = [ALL_ALIVE]
        if self.redundancy > 1:
            deaths += list(dict.fromkeys(readings.beacon.tolist()))
        verdicts = []
        for dead in deaths:
            course = self._course(path, _pick(readings, readings.beacon != dead))
            verdicts.append(Verdict(course.worst, course.end, dead))
            if verdicts[-1].worst > limit:
                break
        if verdicts[-1].worst > limit:
            return verdicts[-1]
        chosen = max(verdicts, key=lambda v: v.end if by_end else v.worst)
        return Verdict(max(v.worst for v in verdicts), max(v.end for v in verdicts), chosen.dead)

    def _readings(self, path: Floats) -> Readings:
        """The readings that count."""
        if not self.beacons:
            nothing = np.zeros(0, dtype=np.intp)
            return Readings(nothing, np.zeros(0), np.zeros(0), nothing)
        found = readings_on(path, self._columns, self.world)
        if self.min_capture == 0 or not len(found.beacon):
            return found
        passes = self._passes(path)
        same = passes.beacon[:, None] == found.beacon
        of_pass = (same & (passes.enter[:, None] <= found.s_m) & (found.s_m <= passes.leave[:, None])).argmax(axis=0)
        counted = np.ones(len(passes.beacon), dtype=bool)
        while True:  # one reading less is more drift on the way to the next
            kept = _pick(found, counted[of_pass])
            arrival = self._course(path, kept).arrival(passes.enter)
            unsure = np.flatnonzero(counted & (self._captured(path, passes, arrival) < self.min_capture))
            if not len(unsure):
                return kept
            counted[unsure] = False

    def _passes(self, path: Floats) -> Passes:
        columns = self._columns
        return passes_of(path, columns.xy, columns.range_m, columns.must_see, self.world)

    def _captured(self, path: Floats, passes: Passes, arrival: PointDrift) -> Floats:
        """Probability of every pass, as `driftplan.beacons.capture.capture` has it, on a coarser grid of errors."""
        from scipy.special import ndtri

        z = ndtri((np.arange(_QUANTILES) + 0.5) / _QUANTILES)
        grid = np.stack(np.meshgrid(z, z), axis=-1).reshape(-1, 2)
        variance, axes = np.linalg.eigh(arrival.cov)
        errors = (np.sqrt(np.maximum(variance, 0.0))[:, None, :] * grid) @ np.swapaxes(axes, -1, -2)
        errors += arrival.bias[:, None, :]
        step = np.diff(path, axis=0)
        square = np.maximum(np.einsum("ij,ij->i", step, step), 1e-300)
        ends = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))])
        chance = np.empty(len(passes.beacon))
        for k, (site, rms) in enumerate(zip(passes.beacon.tolist(), arrival.rms.tolist(), strict=True)):
            reach = self._columns.range_m[site]
            window = reach + _WINDOW * rms
            low, high = float(passes.enter[k]) - window, float(passes.leave[k]) + window
            legs = slice(
                max(int(np.searchsorted(ends, low, side="right")) - 1, 0),
                max(int(np.searchsorted(ends, high, side="left")), 1),
            )
            places = self._columns.xy[site] + errors[k]
            offset = places[:, None, :] - path[:-1][legs]
            share = np.clip(np.einsum("nlk,lk->nl", offset, step[legs]) / square[legs], 0.0, 1.0)
            away = offset - share[..., None] * step[legs]
            nearest = np.einsum("nlk,nlk->nl", away, away).min(axis=1)
            chance[k] = np.mean(nearest <= (reach + 1e-9) ** 2)
        return chance

    def _course(self, path: Floats, readings: Readings) -> Course:
        floor, noises = floor_of(path, self.noise, self.world)
        legs = [noises] * (len(floor) - 1) if isinstance(noises, OdometryNoise) else noises
        return follow(floor, legs, readings, self._laws, self.initial, self.start_heading)


def _pick(readings: Readings, keep: NDArray[np.bool_]) -> Readings:
    return Readings(readings.beacon[keep], readings.s_m[keep], readings.chance[keep], readings.rank[keep])
