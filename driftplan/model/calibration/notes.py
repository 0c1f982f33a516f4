"""Plain sentences: what to know of drives, reference, fit and check before using the numbers. All of them are here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import degrees, hypot, sqrt

import numpy as np

from driftplan.arrays import Floats
from driftplan.model.calibration.chance import LEVELS, LIMITS
from driftplan.model.calibration.matched_drive import MatchedDrive
from driftplan.model.calibration.quasi_likelihood import SYSTEMATIC, Solution, drive_deviations
from driftplan.model.calibration.recordings import OdometryLog, Trajectory
from driftplan.model.calibration.segment_check import SegmentCheck
from driftplan.model.calibration.segment_sets import SegmentSet
from driftplan.model.calibration.segments import TruthNoise
from driftplan.model.noise import OdometryNoise

_ODD_MOUNTING_RAD = 0.2  # a reference's heading turned by more is no matter of a millimetre
HEAVY_TAILS_CHANCE = 0.05  # that Gaussian errors are said not to be so
_CHANCE = 0.01  # that drives are said to differ when they do not
_CLEAR_SHIFT_ERRORS = 3.0  # standard errors by which the systematic errors of other drives are said to differ
_UNITS = {1000: "millimetres or metres", 3.6: "km/h or m/s", 3.28: "feet or metres", 57.3: "degrees or radians"}
_CLEAR_RATIO = 0.15  # of the predicted rms, by which the measured one is at least off if it is said to be


def mounting_notes(matches: Sequence[MatchedDrive]) -> list[str]:
    """Whether true headings are turned by more than a marker is mounted askew."""
    worst = max((m.heading_offset for m in matches), key=abs)
    if abs(worst) < _ODD_MOUNTING_RAD:
        return []
    return [
        f"The truth's headings are turned by {degrees(worst):.0f} deg against the direction in which the odometry "
        "drives, and were turned back: check axes and signs."
    ]


def reference_notes(segments: SegmentSet, truth: TruthNoise, check: SegmentCheck) -> list[str]:
    """Whether the reference is too coarse to see the odometry drift."""
    _, cov = segments.expected(segments.windows(OdometryNoise()), truth)
    white = float(np.trace(segments.by_bin(cov[:, segments.position, segments.position])[-1]))
    longest = check.lengths[-1]
    if white < 0.5 * longest.predicted_rms_m**2:
        return []
    return [
        f"Even over {longest.length_m:.3g} m most of the error does not grow with the distance (white, "
        f"{sqrt(truth.position_var):.2g} m): a better reference or longer segments would tell more about the odometry."
    ]


def fault_notes(segments: SegmentSet, solution: Solution, check: SegmentCheck) -> list[str]:
    """Why the numbers of a fit are not to be used."""
    faults = []
    if all(row.measured_rms_m > row.length_m for row in check.lengths):
        faults.append("The errors are larger than the segments are long: are odometry and truth of the same drive?")
    ratio = _counted_over_true(segments)
    if not 0.5 < ratio < 2:
        unit = next(
            (unit for size, unit in _UNITS.items() if min(abs(ratio / size - 1), abs(ratio * size - 1)) < 0.1), ""
        )
        faults.append(
            f"The odometry counts {ratio:.3g} times the true distance: " + (f"{unit}?" if unit else "check its units.")
        )
    for name, bound in solution.at_bounds.items():
        faults.append(
            f"{name} sits on its bound of {bound:g}: check units and signs of the odometry, and that the truth is of "
            "the same drive."
        )
    if not solution.converged:
        longest = segments.bins[-1].length_m
        faults.append(
            f"The fit did not converge: its last step still moved {solution.slowest}. Fit fewer parameters (without "
            f"this one), give other lengths_m (the longest is {longest:.3g} m), or record more or longer drives."
        )
    return faults


def _counted_over_true(segments: SegmentSet) -> float:
    """Length of the odometry's chords over that of the true ones, over the shortest segments."""
    steps, counted, true = segments.bins[0].steps, 0.0, 0.0
    for part in segments.resampled:
        counted += float(np.abs(part.estimate[steps::steps] - part.estimate[:-steps:steps]).sum())
        true += float(np.abs(part.truth[steps::steps] - part.truth[:-steps:steps]).sum())
    return counted / max(true, 1e-300)


def swap_notes(drives: Sequence[tuple[OdometryLog, Trajectory]]) -> list[str]:
    """Whether the truth, not the odometry, begins at the origin: it may be the other way round."""
    if all(log.start != 0 and truth.positions[0] == 0 for log, truth in drives):
        return ["The truth begins at (0, 0), the odometry elsewhere: are the two swapped?"]
    return []


def drive_notes(segments: SegmentSet, solution: Solution, std_errors: Mapping[str, float]) -> list[str]:
    """Whether systematic errors differ from drive to drive by more than the fit's standard errors explain."""
    from scipy.special import chdtri

    own, names = drive_deviations(segments, solution), [name for name in solution.names if name in SYSTEMATIC]
    drives = len(own)
    if drives < 2:
        return []
    spread = own.std(axis=0, ddof=1)
    limit = sqrt(drives * float(chdtri(drives - 1, _CHANCE)) / (drives - 1))  # in the standard errors of all drives
    return [
        f"The drives differ: {name} varies by {value:.2g} (standard deviation) from one to the next, more than chance "
        "explains. Another drive or robot may be as far off as that from the fitted "
        f"{solution.theta[solution.names.index(name)]:.2g}."
        for name, value in zip(names, spread.tolist(), strict=True)
        if value > limit * std_errors[name]
    ]


def systematic_notes(
    noise: OdometryNoise, found: Mapping[str, tuple[float, float]], std_errors: Mapping[str, float]
) -> list[str]:
    """Which systematic errors, found with their standard errors, are clearly not those of the noise."""
    notes = []
    for name, (value, error) in found.items():
        expected, its_error = getattr(noise, name), std_errors.get(name, 0.0)
        if abs(value - expected) > _CLEAR_SHIFT_ERRORS * hypot(error, its_error):
            notes.append(
                f"The systematic errors differ: {name} seems to be {value:.2g} ± {error:.1g} on these drives, not "
                f"{expected:.2g}" + (f" ± {its_error:.1g}." if its_error else ".")
            )
    return notes


def trust(check: SegmentCheck) -> str:
    """How far the predictions hold on the drives of a check, by length, in one sentence."""
    said = [
        f"{row.measured_rms_m / row.predicted_rms_m:.2f} at {row.length_m:.3g} m ({100 * row.coverage[1]:.0f} %)"
        for row in check.lengths
        if row.predicted_rms_m > 0
    ]
    return f"Measured over predicted rms (share in the 90 % regions): {', '.join(said)}."


def judged(check: SegmentCheck, rms_errors_m: Floats | None = None) -> SegmentCheck:
    """The check with notes on what does not fit, beyond what chance allows; where the prediction owes nothing to these
    segments, the standard errors of its rms (lengths,) count too."""
    found = (_growth_note(check, rms_errors_m), _shape_note(check, rms_errors_m))
    return replace(check, notes=(*check.notes, *(note for note in found if note)))


def _growth_note(check: SegmentCheck, rms_errors_m: Floats | None) -> str:
    """How the rms grows with length, measured over predicted."""
    rows = check.lengths
    measured, predicted, error = (
        np.array([getattr(row, name) for row in rows])
        for name in ("measured_rms_m", "predicted_rms_m", "measured_rms_error_m")
    )
    ratio, error = np.maximum(measured, 1e-300) / predicted, error / np.maximum(measured, 1e-300)
    # as chance was measured, of logarithms: theirs is a mean too low by the error squared, where the square's is right
    shift = np.abs(np.log(ratio) + error**2)
    clear = shift > check.clear_errors[0] * np.hypot(error, 0.0 if rms_errors_m is None else rms_errors_m / predicted)
    if len(rows) < 2 or not (clear & (np.abs(ratio - 1) > _CLEAR_RATIO)).any():
        return ""
    if ratio[-1] > ratio[0] * (1 + _CLEAR_RATIO):
        why = "errors grow faster with length than a random walk's: they are correlated over longer stretches"
    elif ratio[-1] < ratio[0] / (1 + _CLEAR_RATIO):
        why = (
            "errors grow slower with length than a random walk's: part of them does not add up (clock, antenna, "
            "turns undone by the next)"
        )
    else:
        why = "the errors are of another size than in the drives that were fitted"
    return (
        f"The random-walk model does not fit: measured over predicted rms is {ratio[0]:.2f} at {rows[0].length_m:.3g} "
        f"m and {ratio[-1]:.2f} at {rows[-1].length_m:.3g} m; {why}."
    )


def _shape_note(check: SegmentCheck, rms_errors_m: Floats | None) -> str:
    """Whether few segments hold most of the error, or too many fall outside."""
    rows = check.lengths
    share, error = (np.array([getattr(row, name) for row in rows]) for name in ("coverage", "coverage_error"))
    if rms_errors_m is not None:  # regions too large or small by a share p hold χ² exp(-χ²/2) p less or more of χ²
        slope = np.array(LIMITS) * np.exp(-0.5 * np.array(LIMITS))
        relative = rms_errors_m / [row.predicted_rms_m for row in rows]
        error = np.hypot(error, relative[:, None] * slope)
    excess = (share - LEVELS) / np.maximum(error, 1e-12)
    k, chance = check.heavy_tails
    if chance <= HEAVY_TAILS_CHANCE:
        row = rows[k]
        outside = 1 - row.coverage[2]
        tails = f" and {100 * outside:.0f} % outside the 95 % region" if outside > 1 - LEVELS[2] else ""
        narrow = " and too narrow for the rest" if tails else ""
        return (
            f"The errors are not Gaussian: {100 * row.coverage[0]:.0f} % lie inside the 50 % region{tails} at "
            f"{row.length_m:.3g} m. Most of the drift comes from a few places (slips?): the rms may hold, the regions "
            f"are too wide for most segments{narrow}. (Gaussian errors look so in {100 * chance:.2g} % of fits.)"
        )
    if (excess[:, 2] < -check.clear_errors[1]).any():
        row = rows[int(np.argmin(excess[:, 2]))]
        return (
            f"The regions are too small: {100 * (1 - row.coverage[2]):.0f} % of the errors lie outside the 95 % region "
            f"at {row.length_m:.3g} m."
        )
    return ""
