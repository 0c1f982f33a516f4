"""check_noise: how well a noise model, fitted or given, predicts the errors of recorded drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import hypot

from numpy.typing import ArrayLike

from driftplan.model.calibration.quasi_likelihood import RmsSpread, systematic_errors
from driftplan.model.calibration.recordings import OdometryLog, Trajectory
from driftplan.model.calibration.segment_check import SegmentCheck, check_segments
from driftplan.model.calibration.segment_ladder import Ladder, drives_of, ladder_of
from driftplan.model.calibration.segments import TruthNoise
from driftplan.model.noise import OdometryNoise

Estimate = OdometryLog | ArrayLike
Truth = Trajectory | ArrayLike

_CLEAR_SHIFT = 3.0  # standard errors by which the systematic errors of other drives are said to differ


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
    noise : OdometryNoise
        Of the continuous model (no ``step_m``), without ``heading_distance_corr``.
    estimates, truths, lengths_m, use_heading, time_offset_s, heading_offset, max_gap_s :
        As for `fit_noise`.
    truth_position_std_m, truth_heading_std : float
        White errors of the reference: metres per coordinate, rad.

    Returns
    -------
    SegmentCheck
    """
    if noise.step_m is not None or noise.heading_distance_corr != 0:
        raise ValueError(f"expected a noise of the continuous model without heading_distance_corr, got {noise!r}")
    ladder, _ = ladder_of(
        drives_of(estimates, truths),
        lengths_m=lengths_m,
        use_heading=use_heading,
        time_offset_s=time_offset_s,
        heading_offset=heading_offset,
        max_gap_s=max_gap_s,
    )
    truth = TruthNoise(truth_position_std_m**2, truth_heading_std**2)
    return checked(ladder, noise, truth)


def checked(
    ladder: Ladder,
    noise: OdometryNoise,
    truth: TruthNoise,
    std_errors: Mapping[str, float] | None = None,
    spread: RmsSpread | None = None,
) -> SegmentCheck:
    """The check of a noise, and what it says of systematic errors; for a fitted one within its standard errors."""
    found = check_segments(
        ladder,
        *ladder.expected(ladder.windows(noise), truth),
        rms_intervals_m=None if spread is None else spread.intervals,
        rms_errors_m=None if spread is None else spread.std_errors,
    )
    notes = []
    for name, (value, error) in systematic_errors(ladder, noise, truth).items():
        said, its_error = getattr(noise, name), (std_errors or {}).get(name, 0.0)
        if abs(value - said) > _CLEAR_SHIFT * hypot(error, its_error):
            notes.append(
                f"The systematic errors differ: {name} seems to be {value:.2g} ± {error:.1g} on these drives, not "
                f"{said:.2g}" + (f" ± {its_error:.1g}." if its_error else ".")
            )
    return replace(found, notes=(*notes, *found.notes))
