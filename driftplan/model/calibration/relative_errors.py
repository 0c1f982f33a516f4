"""Relative pose errors as benchmarks report them: drift in % and in degrees per metre of segments of given lengths.

KITTI: from every 10th frame, the segment to the first frame whose distance along the *true* path exceeds the length;
errors of the relative pose, translation and rotation angle, divided by the length and averaged over all segments of all
lengths (A. Geiger, P. Lenz, R. Urtasun, Are we ready for autonomous driving?, CVPR 2012, and the odometry development
kit). evo (``evo_rpe --delta L --delta_unit m``, version 1.38): segments one after the other along the *estimated* path,
each as long as it takes to reach the length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, Ints, as_plane, choice, finite, whole
from driftplan.model.calibration.matched_drive import MatchedDrive, MatchOptions, match
from driftplan.model.calibration.recordings import OdometryLog, Trajectory
from driftplan.model.calibration.segment_sets import SegmentSet
from driftplan.tables import Tabular, decimals

KITTI_LENGTHS_M = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
Pairs = Literal["kitti", "evo"]
_FRAMES = 40  # frames in the shortest segment of a fit: its length is overshot by half a frame


class RelativeError(NamedTuple):
    """Errors of the segments of one length.

    Attributes
    ----------
    length_m : float
    segments : int
    translation_percent, rotation_deg_per_m : means over the segments, per length
    translation_rms_m, rotation_rms_deg : root mean squares of the errors themselves
    """

    length_m: float
    segments: int
    translation_percent: float
    rotation_deg_per_m: float
    translation_rms_m: float
    rotation_rms_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RelativeErrors(Tabular):
    """Relative pose errors by length, and over all segments.

    Attributes
    ----------
    lengths : lengths of which there are segments
    translation_percent, rotation_deg_per_m : means over all segments of all lengths; KITTI's ranking figures.
    """

    lengths: tuple[RelativeError, ...]
    translation_percent: float
    rotation_deg_per_m: float

    def to_dicts(self) -> list[dict[str, Any]]:
        """One row per length, by the names of `RelativeError`."""
        return [row._asdict() for row in self.lengths]

    def columns(self) -> dict[str, list[Any]]:
        rows = self.lengths
        return {
            "length m": [*(f"{row.length_m:.4g}" for row in rows), "all"],
            "segments": [*(row.segments for row in rows), sum(row.segments for row in rows)],
            "drift %": decimals([*(row.translation_percent for row in rows), self.translation_percent], 3),
            "deg/m": decimals([*(row.rotation_deg_per_m for row in rows), self.rotation_deg_per_m], 5),
        }


def relative_errors(
    estimate: ArrayLike,
    truth: ArrayLike,
    lengths_m: ArrayLike = KITTI_LENGTHS_M,
    *,
    pairs: Pairs = "kitti",
    step: int = 10,
) -> RelativeErrors:
    """Relative pose errors of an estimated trajectory.

    Parameters
    ----------
    estimate, truth : (n, 3), (n, 3, 4) or (n, 4, 4), poses at the same instants: x, y (m), heading (rad), or matrices
        of the plane's or of space's poses. Each may have a frame of its own.
    lengths_m : segment lengths. KITTI's default, 100 to 800 m, suits cars.
    pairs : {"kitti", "evo"}: which segments; see the module
    step : frames from one segment's start to the next (KITTI only)

    Raises ValueError for wrong shapes, and where the path is shorter than every length.

    >>> frames = np.arange(101.0)
    >>> truth = np.column_stack([frames, 0 * frames, 0 * frames])
    >>> errors = relative_errors(truth * [1.02, 1, 1], truth, [10.0, 50.0])  # 2 % too long
    >>> [round(row.translation_percent, 2) for row in errors.lengths]  # of segments of 11 and 51 m, per 10 and 50 m
    [2.2, 2.04]
    """
    choice("pairs", pairs, Pairs)
    step = whole("step", step, least=1)
    estimated, true = _matrices("estimate", estimate), _matrices("truth", truth)
    if estimated.shape != true.shape:
        raise ValueError(f"expected estimate and truth of one shape, got {np.shape(estimate)} and {np.shape(truth)}")
    lengths = np.atleast_1d(finite("lengths_m", lengths_m))
    if lengths.size == 0 or (lengths <= 0).any():
        raise ValueError(f"expected lengths_m > 0, got {lengths_m!r}")
    path = true if pairs == "kitti" else estimated
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path[:, :3, 3], axis=0), axis=1))])
    rows = []
    for length in lengths.tolist():
        first, last = _kitti_pairs(along, length, step) if pairs == "kitti" else _evo_pairs(along, length)
        if first.size == 0:
            continue
        off = np.linalg.solve(*(np.linalg.solve(poses[first], poses[last]) for poses in (estimated, true)))
        translation = np.linalg.norm(off[:, :3, 3], axis=1)
        cosine = np.clip(0.5 * (np.trace(off[:, :3, :3], axis1=1, axis2=2) - 1), -1.0, 1.0)
        rotation = np.degrees(np.arccos(cosine))
        means = 100 * translation.mean() / length, rotation.mean() / length
        rms = (np.sqrt(np.mean(x**2)) for x in (translation, rotation))
        rows.append(RelativeError(length, int(first.size), *map(float, (*means, *rms))))
    if not rows:
        raise ValueError(f"expected a path longer than {lengths.min():.4g} m, got {along[-1]:.4g} m")
    return pooled(rows)


def pooled(rows: Sequence[RelativeError]) -> RelativeErrors:
    """Errors of segments of several drives and lengths, every segment counting the same."""
    by_length = [[row for row in rows if row.length_m == length] for length in sorted({row.length_m for row in rows})]
    every = _together(rows)
    return RelativeErrors(
        lengths=tuple(map(_together, by_length)),
        translation_percent=every.translation_percent,
        rotation_deg_per_m=every.rotation_deg_per_m,
    )


def _together(rows: Sequence[RelativeError]) -> RelativeError:
    length, count, percent, per_m, rms_m, rms_deg = np.array(rows).T
    means = (np.average(x, weights=count) for x in (percent, per_m))
    rms = (np.sqrt(np.average(x**2, weights=count)) for x in (rms_m, rms_deg))
    return RelativeError(float(length[0]), int(count.sum()), *map(float, (*means, *rms)))


def segment_errors(
    segments: SegmentSet,
    drives: Sequence[tuple[OdometryLog, Trajectory]],
    matches: Sequence[MatchedDrive],
    max_gap_s: float | None,
) -> RelativeErrors | None:
    """Errors of matched drives at the lengths of their segments; frames are the samples of the sparser recording, not
    the segments' knots. None where no part is long enough."""
    lengths = [length.length_m for length in segments.bins]
    found: list[RelativeError] = []
    for (odometry, truth), m in zip(drives, matches, strict=True):
        offsets = MatchOptions(time_offset_s=m.time_offset_s, heading_offset=m.heading_offset, max_gap_s=max_gap_s)
        frames = match(odometry, truth, spacing_m=lengths[0] / _FRAMES, **offsets)
        for part in frames.resampled:
            if part.truth_heading is not None and np.abs(np.diff(part.truth)).sum() > lengths[0]:
                estimate = np.column_stack([part.estimate.real, part.estimate.imag, part.estimate_heading])
                true = np.column_stack([part.truth.real, part.truth.imag, part.truth_heading])
                found += relative_errors(estimate, true, lengths, step=_FRAMES // 4).lengths
    return pooled(found) if found else None


def _kitti_pairs(along: Floats, length: float, step: int) -> tuple[Ints, Ints]:
    first = np.arange(0, len(along), step)
    last = np.searchsorted(along, along[first] + length, side="right")  # first frame that is farther
    reached = last < len(along)
    return first[reached], last[reached]


def _evo_pairs(along: Floats, length: float) -> tuple[Ints, Ints]:
    ends = [0]
    while (end := int(np.searchsorted(along, along[ends[-1]] + length * (1 - 1e-12)))) < len(along):
        ends.append(end)
    return np.array(ends[:-1], dtype=np.intp), np.array(ends[1:], dtype=np.intp)


def _matrices(name: str, poses: Any) -> Floats:
    """Poses as (n, 4, 4) matrices."""
    array = finite(name, poses)
    planar = array.shape[1:] == (3,)
    if not (planar or array.shape[1:] in ((3, 4), (4, 4))) or len(array) < 2:
        raise ValueError(f"expected {name} of shape (n, 3), (n, 3, 4) or (n, 4, 4), n >= 2, got {np.shape(poses)}")
    full = np.tile(np.eye(4), (len(array), 1, 1))
    if planar:
        u = np.exp(1j * array[:, 2])
        full[:, :2, 0], full[:, :2, 1], full[:, :2, 3] = as_plane(u), as_plane(1j * u), array[:, :2]
    else:
        full[:, :3] = array[:, :3]
    return full
