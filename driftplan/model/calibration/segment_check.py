"""Predicted against measured: does a noise model describe the errors of recorded segments?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Floats
from driftplan.model.calibration.segment_ladder import Ladder
from driftplan.tables import decimals, table

LEVELS = (0.5, 0.9, 0.95)


class LengthCheck(NamedTuple):
    """Segments of one length.

    Attributes
    ----------
    length_m : float
        With positions alone the first half serves to align, and the errors are those of the second half's end.
    segments : int
        Overlapping ones.
    independent : float
        How many fit side by side.
    measured_rms_m, predicted_rms_m : float
        Root mean square position error, with the white errors of the reference in both.
    measured_rms_error_m : float
        Standard error of the measured one.
    predicted_rms_interval_m : (float, float)
        Of the predicted one, by the fit's intervals; both are the prediction itself where the noise is taken as given.
    measured_heading_rms, predicted_heading_rms : float
        Of the sine of the heading error gained; nan without true headings.
    coverage : tuple of float
        Share of the errors inside the regions that should hold 50, 90 and 95 %.
    coverage_error : tuple of float
        Standard deviations of these shares if the model were right, for as many independent segments.
    mean_nees : float
        Mean normalised error squared per degree of freedom: 1 if the model is right, above if it promises too much.
    """

    length_m: float
    segments: int
    independent: float
    measured_rms_m: float
    predicted_rms_m: float
    measured_rms_error_m: float
    predicted_rms_interval_m: tuple[float, float]
    measured_heading_rms: float
    predicted_heading_rms: float
    coverage: tuple[float, ...]
    coverage_error: tuple[float, ...]
    mean_nees: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SegmentCheck:
    """What `fit_noise` and `check_noise` found at each length, and what to make of it.

    Attributes
    ----------
    lengths : tuple of LengthCheck
        Shortest first.
    errors_m : tuple of arrays
        Position errors of all segments, metres, by length.
    has_heading : bool
        Whether segments were aligned by measured headings.
    notes : tuple of str
        Plain sentences; empty when the model describes the errors within sampling errors.
    """

    lengths: tuple[LengthCheck, ...]
    errors_m: tuple[Floats, ...]
    has_heading: bool
    notes: tuple[str, ...]

    @property
    def fits(self) -> bool:
        """Whether nothing speaks against the model."""
        return not self.notes

    def __str__(self) -> str:
        rows = self.lengths
        columns = {
            "length m": [f"{row.length_m:.3g}" for row in rows],
            "number": decimals([row.independent for row in rows], 0),
            "rms m": [f"{row.measured_rms_m:.4g}" for row in rows],
            "predicted": [f"{row.predicted_rms_m:.4g}" for row in rows],
        }
        intervals = [row.predicted_rms_interval_m for row in rows]
        if any(low < high for low, high in intervals):
            columns["interval"] = [f"{low:.3g} .. {high:.3g}" for low, high in intervals]
        for k, level in enumerate(LEVELS):
            shares = ((row.coverage[k], row.coverage_error[k]) for row in rows)
            columns[f"{100 * level:g} %"] = [f"{100 * share:5.1f} (±{200 * error:3.0f})" for share, error in shares]
        columns["NEES"] = decimals([row.mean_nees for row in rows], 2)
        head = "errors of segments, measured and predicted; shares inside the predicted regions (± 2 standard errors)"
        return f"{head}\n{table(columns)}"


def check_segments(
    ladder: Ladder,
    mean: Floats,
    cov: Floats,
    *,
    rms_intervals_m: Floats | None = None,
    rms_errors_m: Floats | None = None,
) -> SegmentCheck:
    """The errors of a ladder of segments against their predicted moments, from `Ladder.expected`.

    Parameters
    ----------
    mean, cov : arrays, shapes (n, 3), (n, 3, 3)
    rms_intervals_m : array, shape (lengths, 2), optional
        Of the predicted rms; told, not judged by.
    rms_errors_m : array, shape (lengths,), optional
        Standard errors of the predicted rms, where it owes nothing to these segments: what the verdict allows for.
    """
    cov = cov + ladder.floor()[ladder.rung]
    where = ladder.position
    y, m, C = ladder.values[:, where], mean[:, where], cov[:, where, where]
    nees = np.einsum("ni,nij,nj->n", y - m, np.linalg.inv(C), y - m)
    squares, predicted = (y**2).sum(axis=1), (m**2).sum(axis=1) + np.trace(C, axis1=1, axis2=2)
    gained, heading = ladder.values[:, 2] ** 2, mean[:, 2] ** 2 + cov[:, 2, 2]
    lengths = []
    for k, rung in enumerate(ladder.rungs):
        mine = ladder.rung == k
        independent = max(ladder.total_m / rung.length_m, 1.0)
        rms = float(np.sqrt(squares[mine].mean()))
        least_error = 0.5 / np.sqrt(independent)  # of the rms of a round Gaussian error, relative
        limits = [-2 * np.log1p(-level) for level in LEVELS]  # of χ² with two degrees of freedom
        lengths.append(
            LengthCheck(
                rung.length_m,
                int(mine.sum()),
                independent,
                rms,
                float(np.sqrt(predicted[mine].mean())),
                max(_mean_error(squares[mine], ladder.place_m[mine], rung.length_m) / (2 * rms), least_error * rms)
                if rms > 0
                else 0.0,
                _interval(rms_intervals_m, k, float(np.sqrt(predicted[mine].mean()))),
                float(np.sqrt(gained[mine].mean())) if ladder.has_heading else float("nan"),
                float(np.sqrt(heading[mine].mean())) if ladder.has_heading else float("nan"),
                tuple(float((nees[mine] < limit).mean()) for limit in limits),
                tuple(float(np.sqrt(level * (1 - level) / independent)) for level in LEVELS),
                float(nees[mine].mean() / 2),
            )
        )
    allowed = np.zeros(len(lengths)) if rms_errors_m is None else rms_errors_m
    return SegmentCheck(
        lengths=tuple(lengths),
        errors_m=tuple(np.sqrt(squares[ladder.rung == k]) for k in range(len(lengths))),
        has_heading=ladder.has_heading,
        notes=_verdict(lengths, allowed),
    )


def _interval(intervals: Floats | None, k: int, value: float) -> tuple[float, float]:
    return (value, value) if intervals is None else (float(intervals[k, 0]), float(intervals[k, 1]))


def _mean_error(values: Floats, place_m: Floats, length_m: float) -> float:
    """Standard error of a mean over overlapping segments: from the means of blocks of two segments' length."""
    block = np.floor(place_m / (2 * length_m)).astype(int)
    _, block = np.unique(block, return_inverse=True)
    count = np.bincount(block)
    if len(count) < 3:
        return float(values.std())
    surplus = np.bincount(block, values - values.mean())
    return float(np.sqrt((surplus**2).sum() * len(count) / (len(count) - 1)) / len(values))


def _verdict(lengths: list[LengthCheck], rms_errors_m: Floats) -> tuple[str, ...]:
    """Plain sentences about what does not fit, judged at three standard errors, those of the prediction included."""
    notes = []
    ratio = np.array([row.measured_rms_m / row.predicted_rms_m for row in lengths])
    error = np.hypot([row.measured_rms_error_m for row in lengths], rms_errors_m)
    error = error / [row.predicted_rms_m for row in lengths]
    off = np.abs(ratio - 1) > np.maximum(3 * error, 0.15)
    if len(lengths) > 1 and off.any():
        first, last = lengths[0], lengths[-1]
        if ratio[-1] > ratio[0] * 1.15:
            why = "errors grow faster with length than a random walk's: they are correlated over longer stretches"
        elif ratio[-1] < ratio[0] / 1.15:
            why = (
                "errors grow slower with length than a random walk's: part of them does not add up (clock, antenna, "
                "turns undone by the next)"
            )
        else:
            why = "the errors are of another size than in the drives that were fitted"
        notes.append(
            f"The random-walk model does not fit: measured over predicted rms is {ratio[0]:.2f} at "
            f"{first.length_m:.3g} m and {ratio[-1]:.2f} at {last.length_m:.3g} m; {why}."
        )
    centre = np.array([row.coverage[0] - LEVELS[0] for row in lengths]) / [row.coverage_error[0] for row in lengths]
    tail = np.array([row.coverage[2] - LEVELS[2] for row in lengths]) / [row.coverage_error[2] for row in lengths]
    heavy = (centre > 3) & (np.array([row.mean_nees for row in lengths]) > 0.7)
    if heavy.any():
        row = lengths[int(np.argmax(heavy))]
        outside = 1 - row.coverage[2]
        tails = f" and {100 * outside:.0f} % outside the 95 % region" if outside > 1 - LEVELS[2] else ""
        narrow = " and too narrow for the rest" if tails else ""
        notes.append(
            f"The errors are not Gaussian: {100 * row.coverage[0]:.0f} % lie inside the 50 % region{tails} at "
            f"{row.length_m:.3g} m. Most of the drift comes from a few places (slips?): the rms may hold, the regions "
            f"are too wide for most segments{narrow}."
        )
    if (tail < -3).any() and not heavy.any():
        row = lengths[int(np.argmin(tail))]
        notes.append(
            f"The regions are too small: {100 * (1 - row.coverage[2]):.0f} % of the errors lie outside the 95 % region "
            f"at {row.length_m:.3g} m."
        )
    return tuple(notes)
