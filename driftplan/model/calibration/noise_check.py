"""check_noise: how well a noise model, fitted or given, predicts the errors of recorded drives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import arguments_checked
from driftplan.model.calibration.bootstrap import RmsSpread, systematic_errors
from driftplan.model.calibration.notes import judged, systematic_notes
from driftplan.model.calibration.quasi_likelihood import SYSTEMATIC
from driftplan.model.calibration.recordings import OdometryLog, Trajectory
from driftplan.model.calibration.segment_check import SegmentCheck, check_segments
from driftplan.model.calibration.segment_sets import SegmentSet, drives_of, segment_set
from driftplan.model.calibration.segments import TruthNoise
from driftplan.model.noise import BETWEEN_DRIVES, OdometryNoise

Estimate = OdometryLog | ArrayLike
Truth = Trajectory | ArrayLike


@arguments_checked()
def check_noise(
    noise: OdometryNoise,
    estimates: Estimate | Sequence[Estimate],
    truths: Truth | Sequence[Truth],
    *,
    lengths_m: ArrayLike | None = None,
    truth_position_std_m: float = 0.0,
    truth_heading_std: float = 0.0,
    use_heading: bool | None = None,
    time_offset_s: float | None = None,
    heading_offset: float | None = None,
    max_gap_s: float | None = None,
) -> SegmentCheck:
    """How well a noise model predicts the errors of recorded drives: predicted against measured rms, and coverage.

    Parameters
    ----------
    noise : of the continuous model (no ``step_m``), without ``heading_distance_corr``
    estimates, truths, lengths_m, use_heading, time_offset_s, heading_offset, max_gap_s : as for `fit_noise`
    truth_position_std_m, truth_heading_std : white errors of the reference: metres per coordinate, rad
    """
    if noise.step_m is not None or noise.heading_distance_corr != 0:
        raise ValueError(f"expected a noise of the continuous model without heading_distance_corr, got {noise!r}")
    segments, _ = segment_set(
        drives_of(estimates, truths),
        lengths_m=lengths_m,
        use_heading=use_heading,
        time_offset_s=time_offset_s,
        heading_offset=heading_offset,
        max_gap_s=max_gap_s,
    )
    truth = TruthNoise(truth_position_std_m**2, truth_heading_std**2)
    return checked(segments, noise, truth)


def checked(
    segments: SegmentSet,
    noise: OdometryNoise,
    truth: TruthNoise,
    spread: RmsSpread | None = None,
) -> SegmentCheck:
    """The check of a noise, and what it says of systematic errors; for a fit within what it knows."""
    mean, cov = segments.expected(segments.windows(noise), truth)
    values, slopes = systematic_errors(segments, noise.on_drive((0, 0, 0)), truth)
    between = {name: getattr(noise, std) for name, std in BETWEEN_DRIVES.items()}
    variances = np.array([between[name] for name in SYSTEMATIC]) ** 2
    cov = cov + np.einsum("nki,k,nkj->nij", slopes, variances, slopes)
    found = check_segments(
        segments, noise, truth, moments=(mean, cov), rms_intervals_m=None if spread is None else spread.intervals
    )
    shifts = systematic_notes(noise, values, between)
    return judged(replace(found, notes=tuple(shifts)), None if spread is None else spread.std_errors)
