"""Predicted against measured: does a noise model describe the errors of recorded segments?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Floats
from driftplan.model.calibration.chance import LEVELS, LIMITS, by_chance, normalised_squares, tail_weight
from driftplan.model.calibration.segment_sets import SegmentSet
from driftplan.model.calibration.segments import TruthNoise
from driftplan.model.noise import OdometryNoise
from driftplan.tables import decimals, table


class LengthCheck(NamedTuple):
    """Segments of one length.

    Attributes
    ----------
    length_m : with positions alone the first half serves to align, and the errors are those of the second half's end
    segments : overlapping ones
    independent : how many fit side by side
    measured_rms_m, predicted_rms_m : root mean square position error, with the white errors of the reference in both
    measured_rms_error_m : standard error of the measured one
    predicted_rms_interval_m : of the predicted one, by the fit's intervals; both are the prediction itself where the
        noise is taken as given
    measured_heading_rms, predicted_heading_rms : of the sine of the heading error gained; nan without true headings
    coverage : share of the errors inside the regions that should hold 50, 90 and 95 %
    coverage_error : standard deviations of these shares if the model were right (`driftplan.model.calibration.chance`)
    mean_nees : mean normalised error squared per degree of freedom: 1 if the model is right, above if it promises too
        much
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
    lengths : shortest first
    errors_m : position errors of all segments, metres, by length
    has_heading : whether segments were aligned by measured headings
    heavy_tails : (int, float)
        Index of the length at which most of the error lies in the fewest segments, and the chance that Gaussian errors
        look so at some length.
    clear_errors : standard errors by which measured rms, and shares in the widest region, differ clearly at some length
    notes : plain sentences; empty when the model describes the errors within sampling errors
    """

    lengths: tuple[LengthCheck, ...]
    errors_m: tuple[Floats, ...]
    has_heading: bool
    heavy_tails: tuple[int, float]
    clear_errors: tuple[float, float]
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
    noise: OdometryNoise,
    truth: TruthNoise,
    *,
    moments: tuple[Floats, Floats] | None = None,
    rms_intervals_m: Floats | None = None,
) -> SegmentCheck:
    """The errors of segments against those that a noise predicts; `driftplan.model.calibration.notes.judged` adds the
    verdict.

    Parameters
    ----------
    moments : (n, 3), (n, 3, 3), optional, in place of those of the noise: each drive's as the others predict it
    rms_intervals_m : (lengths, 2), optional, of the predicted rms; told, not judged by
    """
    mean, cov = segments.expected(segments.windows(noise), truth) if moments is None else moments
    cov = cov + segments.floor()[segments.bin_of]
    where = segments.position
    m, C = mean[:, where], cov[:, where, where]
    nees = normalised_squares(segments, segments.values, mean, cov)
    squares, predicted = (
        (segments.values[:, where] ** 2).sum(axis=1),
        (m**2).sum(axis=1) + np.trace(C, axis1=1, axis2=2),
    )
    gained, heading = segments.values[:, 2] ** 2, mean[:, 2] ** 2 + cov[:, 2, 2]
    chance = by_chance(segments, noise, truth, mean, cov)
    relative_error, share_errors = chance.log_rms.std(axis=0), chance.shares.std(axis=0)
    lengths, tails = [], []
    for k, length in enumerate(segments.bins):
        mine = segments.bin_of == k
        rms, predicted_rms = (float(np.sqrt(x[mine].mean())) for x in (squares, predicted))
        scatter = _mean_error(squares[mine], segments.place_m[mine], length.length_m) / (2 * rms) if rms > 0 else 0.0
        tails.append(tail_weight(nees[mine]))
        lengths.append(
            LengthCheck(
                length.length_m,
                int(mine.sum()),
                max(segments.total_m / length.length_m, 1.0),
                rms,
                predicted_rms,
                max(scatter, float(relative_error[k]) * rms),
                _interval(rms_intervals_m, k, predicted_rms),
                float(np.sqrt(gained[mine].mean())) if segments.has_heading else float("nan"),
                float(np.sqrt(heading[mine].mean())) if segments.has_heading else float("nan"),
                tuple(float((nees[mine] < limit).mean()) for limit in LIMITS),
                tuple(float(error) for error in share_errors[k]),
                float(nees[mine].mean() / 2),
            )
        )
    return SegmentCheck(
        lengths=tuple(lengths),
        errors_m=tuple(np.sqrt(squares[segments.bin_of == k]) for k in range(len(lengths))),
        has_heading=segments.has_heading,
        heavy_tails=chance.heavy_tails(np.array(tails)),
        clear_errors=(chance.clear_rms_errors, chance.clear_share_errors),
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
