"""Readings: absolute measurements on the way, and what a robot's estimator makes of them.

Where and when a reading is taken. A reading within `driftplan.model.paths.SAME_PLACE_M` of a waypoint is taken at the
waypoint, and readings that near to each other are taken at one place; at one place the order is that of their rank
(the most accurate last), then that in which they were given. A reading at a waypoint is taken on arrival there, before
the robot turns on the spot. Every engine (predictions, itineraries, placement) goes by
`driftplan.model.paths.Runs.cut`, which says so once.

What a reading does. The estimator ``reset`` replaces what is measured, see `Resets.apply`, the one place that says so.
The estimator ``filter`` fuses it in a Kalman filter, see `driftplan.model.filter_state`; only it can use a range or a
bearing, which tell neither position nor heading by themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import (
    Array,
    Bools,
    Columns,
    Complexes,
    Floats,
    Ints,
    as_covariance,
    as_plane,
    covariance,
    finite,
    instance,
    not_negative,
    number,
    shaped,
)
from driftplan.model.filter_state import AXES, Row, bearing_row, heading_row, position_rows, range_row
from driftplan.model.heading_laws import law_moments
from driftplan.model.moments import Moments, identity

Estimator = Literal["reset", "filter"]
NEEDS_FILTER = (
    "a range or a bearing tells neither position nor heading by itself, "
    "a robot that replaces what it reads cannot use it"
)
_NEAREST_ANCHOR_M = 0.01  # a range or bearing from nearer is left out: no direction, and nothing linear about it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fix:
    """An absolute measurement at the distance ``s_m`` along a path.

    A robot that resets replaces the measured quantity's error by the measurement's, independent of all before: a full
    fix replaces position and heading error, a position fix (RFID) leaves the heading error, a heading fix the position
    error. A fix less accurate than the estimate then makes it worse. A robot with a filter fuses it: a position fix
    also corrects heading, and no fix ever hurts. Ranges and bearings need a filter.

    In the step model (``step_m``) a fix, detected or not, ends a step: its run counts steps anew on either side.

    Attributes
    ----------
    s_m : where along the path, metres from its start
    position_cov : (2, 2) array or None
        Covariance of the measured position, m², world frame; None: position not measured.
    heading_std : standard deviation of the measured heading, rad (Gaussian); None: heading not measured.
    detection_probability : probability that the measurement happens at all; else the drift goes on as without a fix
    range_std_m, bearing_std : standard deviation of the measured distance to ``anchor`` (m), and of its measured
        direction in the robot's frame (rad)
    anchor : (2,) array or None: where the beacon is to which a range or bearing is measured, metres, world frame

    Raises ValueError for negative or infinite values, a covariance that is none, a probability outside [0, 1].

    >>> Fix.position(12.0, position_std_m=0.1).position_cov
    array([[0.01, 0.  ],
           [0.  , 0.01]])
    """

    s_m: float
    position_cov: Floats | None = None
    heading_std: float | None = None
    detection_probability: float = 1.0
    range_std_m: float | None = None
    bearing_std: float | None = None
    anchor: Floats | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "s_m", not_negative("s_m", self.s_m))
        if all(x is None for x in (self.position_cov, self.heading_std, self.range_std_m, self.bearing_std)):
            raise ValueError("expected a fix to measure position_cov, heading_std or both, got neither")
        for name in ("heading_std", "range_std_m", "bearing_std"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, not_negative(name, getattr(self, name)))
        if (self.range_std_m is None and self.bearing_std is None) != (self.anchor is None):
            raise ValueError("expected an anchor with a range or bearing, and only then")
        if self.anchor is not None:
            anchor = shaped("anchor", self.anchor, (2,)).copy()
            anchor.setflags(write=False)
            object.__setattr__(self, "anchor", anchor)
        if not 0 <= number("detection_probability", self.detection_probability) <= 1:
            raise ValueError(f"expected detection_probability in [0, 1], got {self.detection_probability!r}")
        if self.position_cov is not None:
            cov = covariance("position_cov", self.position_cov).copy()
            cov.setflags(write=False)
            object.__setattr__(self, "position_cov", cov)

    @classmethod
    def full(cls, s_m: float, *, position_std_m: float, heading_std: float, detection_probability: float = 1.0) -> Fix:
        """Position and heading: an AprilTag, a reflector set, a docking station. ``position_std_m`` is per axis.

        >>> Fix.full(10.0, position_std_m=0.1, heading_std=0.02).heading_std
        0.02
        """
        return cls(
            s_m=s_m,
            position_cov=_isotropic(position_std_m),
            heading_std=heading_std,
            detection_probability=detection_probability,
        )

    @classmethod
    def position(cls, s_m: float, *, position_std_m: float, detection_probability: float = 1.0) -> Fix:
        """Position only: an RFID tag. ``position_std_m`` is per axis."""
        return cls(s_m=s_m, position_cov=_isotropic(position_std_m), detection_probability=detection_probability)

    @classmethod
    def heading(cls, s_m: float, *, heading_std: float, detection_probability: float = 1.0) -> Fix:
        """Heading only: a compass, a wall of known direction."""
        return cls(s_m=s_m, heading_std=heading_std, detection_probability=detection_probability)

    @classmethod
    def range(cls, s_m: float, *, anchor: ArrayLike, range_std_m: float, detection_probability: float = 1.0) -> Fix:
        """Distance to an anchor only: an ultra-wideband radio. It needs a filter.

        >>> Fix.range(10.0, anchor=(3.0, 4.0), range_std_m=0.1).anchor
        array([3., 4.])
        """
        return cls(
            s_m=s_m,
            anchor=finite("anchor", anchor),
            range_std_m=range_std_m,
            detection_probability=detection_probability,
        )

    @classmethod
    def bearing(cls, s_m: float, *, anchor: ArrayLike, bearing_std: float, detection_probability: float = 1.0) -> Fix:
        """Direction (rad, robot's frame) of a landmark that a camera or laser recognises. It needs a filter."""
        return cls(
            s_m=s_m,
            anchor=finite("anchor", anchor),
            bearing_std=bearing_std,
            detection_probability=detection_probability,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Readings(Columns):
    """Readings along one path, or laws of readings, as arrays of one length.

    >>> Readings.of([Fix.position(3.0, position_std_m=0.1), Fix.heading(5.0, heading_std=0.02)]).s_m.tolist()
    [3.0, 5.0]
    """

    s_m: Floats  # where along the path, metres
    square: Floats  # E|e|² of the position error that is read, m²; NaN where none is
    skew: Complexes  # E[e²] of it, m²
    heading_var: Floats  # variance of the heading error that is read, rad² (Gaussian); NaN where none is
    chance: Floats  # probability that the reading succeeds
    rank: Ints  # of readings at one place the one with the highest rank comes last
    source: Ints  # which fix or beacon gives it
    anchor: Complexes  # metres: to what a range or bearing is measured; NaN where neither is
    range_var: Floats  # variance of a distance that is read, m²; NaN where none is
    bearing_var: Floats  # and of a direction, rad²

    @classmethod
    def of(cls, fixes: Sequence[Fix]) -> Readings:
        """The readings that fixes are: they come before those of beacons at one place."""
        count = len(fixes)
        for fix in fixes:
            instance("a fix", fix, Fix)
        cov = [((np.nan, 0.0), (0.0, np.nan)) if f.position_cov is None else f.position_cov.tolist() for f in fixes]
        (xx, xy), (_, yy) = np.array(cov, dtype=float).reshape(count, 2, 2).transpose(1, 2, 0)
        return cls(
            np.array([fix.s_m for fix in fixes], dtype=float),
            xx + yy,
            xx - yy + 2j * xy,
            np.array([fix.heading_std for fix in fixes], dtype=float) ** 2,  # None: NaN
            np.array([fix.detection_probability for fix in fixes], dtype=float),
            np.full(count, -1),
            np.arange(count),
            np.array([np.nan if f.anchor is None else complex(*f.anchor) for f in fixes], dtype=complex),
            np.array([fix.range_std_m for fix in fixes], dtype=float) ** 2,
            np.array([fix.bearing_std for fix in fixes], dtype=float) ** 2,
        )

    def __len__(self) -> int:
        return len(self.s_m)

    def __add__(self, more: Readings) -> Readings:
        """These and, at one place after those of the same rank, ``more``."""
        return Readings(*(np.concatenate(pair) for pair in zip(self.arrays(), more.arrays(), strict=True)))

    @property
    def read_position(self) -> Bools:
        return ~np.isnan(self.square)

    @property
    def read_heading(self) -> Bools:
        return ~np.isnan(self.heading_var)

    def resets(self) -> Resets:
        """What the estimator ``reset`` makes of them; ValueError for a range or a bearing, which need a filter."""
        if not (np.isnan(self.range_var) & np.isnan(self.bearing_var)).all():
            raise ValueError(f"{NEEDS_FILTER}; expected estimator='filter'")
        places, turns = self.read_position, self.read_heading
        law = law_moments("gaussian", np.where(turns, self.heading_var, 0.0))
        placed, turned = self.chance * places, self.chance * turns
        return Resets(
            keep_heading=1 - turned,
            d1=turned * law.d1,
            d2=turned * law.d2,
            keep_position=1 - placed,
            N=self.chance * np.where(places, self.square, 0.0),
            e2=self.chance * np.where(places, self.skew, 0.0),
            keep_cross=1 - self.chance,
            lever=(turned - placed * turns) * law.d1,
        )

    def fixes(self) -> list[Fix]:
        """The same as fixes, in driving order."""
        xx, yy, xy = (self.square + self.skew.real) / 2, (self.square - self.skew.real) / 2, self.skew.imag / 2
        stds = {"heading_std": self.heading_var, "range_std_m": self.range_var, "bearing_std": self.bearing_var}
        return [
            Fix(
                s_m=float(self.s_m[k]),
                position_cov=np.array([[xx[k], xy[k]], [xy[k], yy[k]]]) if self.read_position[k] else None,
                detection_probability=float(self.chance[k]),
                anchor=None if np.isnan(self.anchor[k]) else as_plane(self.anchor[k]),
                **{name: None if np.isnan(var[k]) else float(var[k]) ** 0.5 for name, var in stds.items()},
            )
            for k in np.lexsort((self.rank, self.s_m)).tolist()
        ]

    def measured(self, positions: Array) -> Row:
        """The numbers that the estimator ``filter`` reads at true ``positions`` (k,), x + jy in metres: position along
        two axes, heading, range and bearing, (k, 5); what is not read has an infinite variance."""
        towards, straight = as_plane(self.anchor - positions), self.skew.imag == 0
        afar = np.hypot(towards[:, 0], towards[:, 1]) > _NEAREST_ANCHOR_M  # false too where there is no anchor
        cov = as_covariance(np.zeros(()), self.square, self.skew)
        h, variance = np.zeros((3, len(self), 5)), np.full((len(self), 5), np.inf)
        kinds: tuple[tuple[int, Bools, Callable[[Bools], tuple[Row, ...]]], ...] = (
            (0, self.read_position & straight, lambda which: position_rows(cov[which])),
            (0, self.read_position & ~straight, lambda which: position_rows(cov[which])),
            (2, self.read_heading, lambda which: (heading_row(self.heading_var[which]),)),
            (3, afar & ~np.isnan(self.range_var), lambda which: (range_row(towards[which], self.range_var[which]),)),
            (4, afar & ~np.isnan(self.bearing_var), lambda k: (bearing_row(towards[k], self.bearing_var[k]),)),
        )
        for first, which, rows in kinds:
            for k, row in enumerate(rows(which) if which.any() else (), start=first):
                variance[which, k] = row.variance
                for axis, coefficient in enumerate(row.coefficients):
                    h[axis, which, k] = coefficient
        return Row((h[0], h[1], h[2]), variance)

    def rows(self, positions: Array) -> list[tuple[tuple[Row, ...], float | None]]:
        """What the estimator ``filter`` makes of each at true ``positions``: numbers that are measured, and the chance
        of that, None for certainty."""
        h, variance = self.measured(positions)
        read = np.isfinite(variance)
        coefficients = zip(*(x[read].tolist() for x in h), strict=True)
        rows = [Row(AXES.get(x, x), var) for x, var in zip(coefficients, variance[read].tolist(), strict=True)]
        spans = pairwise([0, *np.cumsum(read.sum(axis=1)).tolist()])
        chances = (None if chance == 1 else chance for chance in self.chance.tolist())
        return [(tuple(rows[begin:end]), chance) for (begin, end), chance in zip(spans, chances, strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class Resets(Columns):
    """What readings do to error moments when they replace what they measure: each a linear map with these coefficients.

    With probability ``chance`` the heading error δ, if it is read, becomes a fresh one with moments d1, d2, -2 d1, and
    the position error e, if it is read, a fresh one with E|e|² and E[e²]; fresh errors have mean zero and are
    independent of what stays, so E[e conj δ] = E e conj(E δ) afterwards. Moments of a mixture are mixtures of moments.
    """

    keep_heading: Array
    d1: Array
    d2: Array
    keep_position: Array
    N: Array
    e2: Array
    keep_cross: Array
    lever: Array

    def apply(self, before: Moments) -> Moments:
        """Exact error moments (world frame) just after readings, given those just before; of any shape, or numbers.

        >>> tag = Readings.of([Fix.position(0.0, position_std_m=0.1)])
        >>> tag.resets()[0].apply(identity()).N.round(3).item()
        0.02
        """
        e1, turn, place = before.e1, self.keep_heading, self.keep_position
        d1, d2, D = turn * before.d1 + self.d1, turn * before.d2 + self.d2, turn * before.D - 2 * self.d1
        a, b = self.keep_cross * before.a + self.lever * e1, self.keep_cross * before.b + self.lever * e1
        N, e2 = place * before.N + self.N, place * before.e2 + self.e2
        return Moments(before.u, before.p, d1, d2, D, place * e1, N, e2, a, b)


def start_errors(start_fix: Fix | None) -> Moments:
    """Error moments at the start of a path (world frame): none, or those of a fix."""
    return identity() if start_fix is None else Readings.of([start_fix]).resets()[0].apply(identity())


def _isotropic(position_std_m: float) -> Floats:
    return not_negative("position_std_m", position_std_m) ** 2 * np.eye(2)
