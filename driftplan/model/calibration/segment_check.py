"""Predicted against measured: does a noise model describe the errors of recorded segments?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Floats
from driftplan.model.calibration.segment_sets import SegmentSet
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
    segments: SegmentSet,
    mean: Floats,
    cov: Floats,
    *,
    rms_intervals_m: Floats | None = None,
) -> SegmentCheck:
    """The errors of segments against their predicted moments, from `SegmentSet.expected`;
    `driftplan.model.calibration.notes.judged` adds the verdict.

    Parameters
    ----------
    mean, cov : arrays, shapes (n, 3), (n, 3, 3)
    rms_intervals_m : array, shape (lengths, 2), optional
        Of the predicted rms; told, not judged by.
    """
    cov = cov + segments.floor()[segments.bin_of]
    where = segments.position
    y, m, C = segments.values[:, where], mean[:, where], cov[:, where, where]
    nees = np.einsum("ni,nij,nj->n", y - m, np.linalg.inv(C), y - m)
    squares, predicted = (y**2).sum(axis=1), (m**2).sum(axis=1) + np.trace(C, axis1=1, axis2=2)
    gained, heading = segments.values[:, 2] ** 2, mean[:, 2] ** 2 + cov[:, 2, 2]
    lengths = []
    for k, length in enumerate(segments.bins):
        mine = segments.bin_of == k
        independent = max(segments.total_m / length.length_m, 1.0)
        rms = float(np.sqrt(squares[mine].mean()))
        least_error = 0.5 / np.sqrt(independent)  # of the rms of a round Gaussian error, relative
        limits = [-2 * np.log1p(-level) for level in LEVELS]  # of χ² with two degrees of freedom
        lengths.append(
            LengthCheck(
                length.length_m,
                int(mine.sum()),
                independent,
                rms,
                float(np.sqrt(predicted[mine].mean())),
                max(_mean_error(squares[mine], segments.place_m[mine], length.length_m) / (2 * rms), least_error * rms)
                if rms > 0
                else 0.0,
                _interval(rms_intervals_m, k, float(np.sqrt(predicted[mine].mean()))),
                float(np.sqrt(gained[mine].mean())) if segments.has_heading else float("nan"),
                float(np.sqrt(heading[mine].mean())) if segments.has_heading else float("nan"),
                tuple(float((nees[mine] < limit).mean()) for limit in limits),
                tuple(float(np.sqrt(level * (1 - level) / independent)) for level in LEVELS),
                float(nees[mine].mean() / 2),
            )
        )
    return SegmentCheck(
        lengths=tuple(lengths),
        errors_m=tuple(np.sqrt(squares[segments.bin_of == k]) for k in range(len(lengths))),
        has_heading=segments.has_heading,
        notes=(),
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
