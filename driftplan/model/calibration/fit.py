"""fit_noise: an `OdometryNoise` from recorded odometry and truth, with intervals and a verdict on the fit.

The direction matters: `OdometryNoise` says how the estimate errs given the path truly driven, so the truth's increments
are the nominal path, and the odometry is what varies about them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from html import escape
from math import degrees, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Complexes, Floats, whole
from driftplan.model.calibration.matched_drive import MatchCounts, MatchOptions
from driftplan.model.calibration.noise_check import Estimate, SegmentCheck, Truth, check_segments, checked, repetitions
from driftplan.model.calibration.notes import data_notes, drive_notes, fault_notes
from driftplan.model.calibration.quasi_likelihood import (
    DRIVES_TO_HOLD_OUT,
    RANDOM,
    SYSTEMATIC,
    TRUTH,
    Solution,
    between_drives,
    bootstrap,
    held_out,
    models,
    rms_spread,
    solution_at,
    solve,
    student_allowance,
    systematic_covariance,
)
from driftplan.model.calibration.relative_errors import RelativeErrors, segment_errors
from driftplan.model.calibration.resampling import laid_on_truth
from driftplan.model.calibration.segment_sets import SegmentSet, drives_of, segment_set
from driftplan.model.noise import OdometryNoise
from driftplan.tables import Tabular, table

PARAMETERS = SYSTEMATIC + RANDOM

_MOST_STEPS = 50
_FIRST_LOOK = 4  # steps after which collinear rates are told
_COLLINEAR = 20.0  # variance inflation above which a rate per radian cannot be told from one per metre
_STRAIGHT_RAD = 0.2  # turned per longest segment: below, nothing is learnt about turning


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseFit(Tabular):
    """A noise model fitted to recordings; made by `fit_noise`, shown by ``print``.

    Attributes
    ----------
    noise : with the spread from drive to drive, over which `predict_drift` averages
    between_drives : standard deviations by which another drive's systematic errors differ from the fitted ones, by the
        names of `OdometryNoise`: the fit's own errors, and from two drives on the spread between them. After one drive
        that spread is taken for as large as the fit's own error, which is a guess.
    intervals : interval of every fitted parameter, by name, at ``confidence``: block bootstrap
    std_errors : standard errors, by name
    confidence : float
    truth_position_std_m, truth_heading_std : white errors of the reference itself, fitted too so that they are not
        taken for drift: metres per coordinate, rad. They take up what does not grow along the way, like timing jitter.
    check : predicted against measured on the drives of the fit themselves; for other drives see `check_on`
    held_out : the same with every part of the drives predicted from the other parts: each drive from the others where
        there are three or more, else each fifth from the other four
    relative_errors : drift in % and deg/m at the same lengths, as KITTI's development kit counts it: to compare
        odometries by, without any model. None where true headings are not used.
    heading_rms_intervals : (lengths, 2) or None, of the predicted rms sine of the heading error gained, as in ``check``
    counts : what became of the recordings
    time_offsets_s : truth clock minus odometry clock, of every drive
    heading_offsets : true heading as measured minus the robot's, of every drive, rad: how marker or sensor are mounted.
        0 where true headings are not used, or the angle is too small to be sure of.
    faults : why the numbers are not to be used: no convergence, a value on its bound, the truth of another drive
    tracks : tuple of (array, array), shapes (K,)
        True and estimated positions x + jy of every uninterrupted part, metres, laid on the truth's first eighth.
    notes : the faults, and what to know before using the numbers: rates left out, drives that differ, a wrong model

    >>> from driftplan import simulate_log
    >>> drive = simulate_log(5 * [(0, 0), (5, 0), (5, 5), (0, 5)], OdometryNoise(distance_scale_error=0.02))
    >>> fit = fit_noise(*drive, parameters=["distance_scale_error"], resamples=100)
    >>> round(fit.noise.distance_scale_error, 4), fit.faults
    (0.02, ())
    """

    noise: OdometryNoise
    between_drives: dict[str, Any]
    intervals: dict[str, tuple[float, float]]
    std_errors: dict[str, float]
    confidence: float
    truth_position_std_m: float
    truth_heading_std: float
    check: SegmentCheck
    held_out: SegmentCheck
    relative_errors: RelativeErrors | None
    heading_rms_intervals: Floats | None
    counts: MatchCounts
    time_offsets_s: tuple[float, ...]
    heading_offsets: tuple[float, ...]
    _fitted: tuple[tuple[str, ...], Floats] = field(repr=False)
    _replicates: Floats = field(repr=False)
    tracks: tuple[tuple[Complexes, Complexes], ...] = ()
    faults: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def check_on(
        self,
        estimates: Estimate | Sequence[Estimate],
        truths: Truth | Sequence[Truth],
        *,
        lengths_m: ArrayLike | None = None,
        **options: Any,
    ) -> SegmentCheck:
        """Predicted against measured errors on drives that were not fitted, recorded with the same reference.

        As for `fit_noise`; ``options`` are ``use_heading``, ``time_offset_s``, ``heading_offset``, ``max_gap_s``.
        """
        segments, _ = segment_set(drives_of(estimates, truths), lengths_m=lengths_m, **options)
        there = solution_at(segments, *self._fitted)
        spread = rms_spread(segments, there, self._replicates, self.confidence, segments.position)
        noise, truth = models(there.names, there.theta)
        return checked(segments, replace(noise, **self.between_drives), truth, spread)

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"

    def to_dicts(self) -> list[dict[str, Any]]:
        """One row per fitted rate, in the units of `OdometryNoise`."""
        names = ("rate", "fitted", "std_error", "low", "high")
        rows = (
            (name, getattr(self.noise, name), self.std_errors[name], *held) for name, held in self.intervals.items()
        )
        return [dict(zip(names, row, strict=True)) for row in rows]

    def columns(self) -> dict[str, list[str]]:
        rows = self.to_dicts()
        return {
            "rate": [row["rate"] for row in rows],
            "fitted": [f"{row['fitted']:.4g}" for row in rows],
            "std error": [f"{row['std_error']:.2g}" for row in rows],
            f"{100 * self.confidence:.3g} % interval": [f"{row['low']:.4g} .. {row['high']:.4g}" for row in rows],
        }

    def __str__(self) -> str:
        reference = f"white errors of the reference: {self.truth_position_std_m:.2g} m"
        if self.check.has_heading:
            reference += f", {degrees(self.truth_heading_std):.2g} deg"
        counts = self.counts
        drives = len(self.time_offsets_s)
        seen = f"of {drives} drives" if drives > 1 else "a guess after one drive: as much as the fit's own error"
        spreads = ", ".join(f"{name} {value:.2g}" for name, value in self.between_drives.items())
        lines = [
            table(self.columns()),
            *([f"from drive to drive ({seen}): {spreads}"] if spreads else []),
            "",
            reference,
            f"{counts.used_m:.1f} m used (the odometry counted {counts.driven_m:.1f} m in all), "
            f"{counts.turned_rad:.1f} rad turned, {counts.standstill_s:.1f} s of standstill",
            f"left out: {counts.outside_truth_s:.1f} s without truth, {counts.repeated_samples} repeated samples, "
            f"{counts.truth_outliers} outliers of the truth and {counts.odometry_outliers} of the odometry; "
            f"{counts.breaks} breaks",
            "clock offset: " + ", ".join(f"{offset:+.3f} s" for offset in self.time_offsets_s),
        ]
        if any(self.heading_offsets):
            turned = ", ".join(f"{degrees(offset):+.2f} deg" for offset in self.heading_offsets)
            lines.append(f"the reference's heading is mounted askew, and was turned back: {turned}")
        others = "each drive predicted from the others"
        few = "each fifth of the drives predicted from the other four"
        lines += ["", others if drives >= DRIVES_TO_HOLD_OUT else few, str(self.held_out)]
        if self.relative_errors is not None:
            lines += ["", "relative errors, as KITTI's development kit counts them", str(self.relative_errors)]
        last = self.notes or ("Nothing speaks against this fit: errors are as predicted, within chance.",)
        return "\n".join([*lines, "", *last]).rstrip()


def fit_noise(
    estimates: Estimate | Sequence[Estimate],
    truths: Truth | Sequence[Truth],
    *,
    parameters: Sequence[str] = PARAMETERS,
    lengths_m: ArrayLike | None = None,
    use_heading: bool | None = None,
    time_offset_s: float | None = None,
    heading_offset: float | None = None,
    max_gap_s: float | None = None,
    confidence: float = 0.95,
    resamples: int = 1000,
    seed: int = 0,
) -> NoiseFit:
    """The noise of an odometry from recorded drives whose truth is known.

    Systematic and random errors are told apart by a quasi-likelihood of the errors of segments of several lengths, with
    the closed-form moments of the model at every one of them (`driftplan.model.calibration.quasi_likelihood`);
    intervals by a moving-block bootstrap along the drives.

    Parameters
    ----------
    estimates : odometry of one drive or several, each an `OdometryLog` or an (n, 3) array of poses x, y, heading
    truths : theirs, each a `Trajectory` or an (n, 2) or (n, 3) array, sampled at the same instants as the estimate's.
        Positions are enough; true headings, where measured independently, make the fit sharper.
    parameters : fields of `OdometryNoise` to fit, of `PARAMETERS`; the others are 0
    lengths_m : lengths of the segments, metres. Default: five, each half the next, the longest 1/16 of all drives
        together (at most 1/4 of the shortest). All lengths count the same; choose those for which you want predictions.
    use_heading : whether to use true headings. Default: if all drives have them, and they are more than the odometry's.
    time_offset_s, heading_offset, max_gap_s : see `driftplan.model.calibration.matched_drive.match`
    confidence : of the intervals
    resamples : bootstrap replicates
    seed : of the bootstrap

    Raises ValueError for arguments out of range, recordings that do not overlap, and drives too short for the segments.

    >>> from driftplan.model.calibration.recordings import simulate_log
    >>> noise = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3, distance_scale_error=0.02)
    >>> square = [(0, 0), (5, 0), (5, 5), (0, 5)]
    >>> odometry, truth = simulate_log(20 * square, noise, rng=1)
    >>> fit = fit_noise(odometry, truth)
    >>> low, high = fit.intervals["distance_scale_error"]
    >>> bool(low < 0.02 < high)
    True
    """
    names = () if isinstance(parameters, str) else tuple(parameters)
    if not names or not set(names) <= set(PARAMETERS):
        raise ValueError(f"expected parameters from {PARAMETERS}, got {parameters!r}")
    names = tuple(name for name in PARAMETERS if name in names)
    if not 0.01 <= confidence <= 0.9999:
        raise ValueError(f"expected confidence from 0.01 to 0.9999, got {confidence!r}")
    whole("resamples", resamples, least=100)
    whole("seed", seed, least=0)
    drives = drives_of(estimates, truths)
    offsets: MatchOptions = {"time_offset_s": time_offset_s, "heading_offset": heading_offset, "max_gap_s": max_gap_s}
    segments, matches = segment_set(drives, lengths_m=lengths_m, use_heading=use_heading, **offsets)
    if len(segments.values) < len(names):
        raise ValueError(
            f"expected drives with at least as many segments as there are rates to fit, {len(names)}, got "
            f"{len(segments.values)}: record longer drives, or fit fewer parameters"
        )
    found, notes = estimated(segments, names, confidence, resamples, seed)
    solution, replicates, std_errors = found.solution, found.replicates, found.std_errors
    noise, truth = models(solution.names, solution.theta)
    spread = rms_spread(segments, solution, replicates, confidence, segments.position)
    again, moments = repetitions(segments, noise, truth), segments.expected(segments.windows(noise), truth)
    check = check_segments(segments, moments, again, spread.intervals)
    relative = heading_rms = None
    if segments.has_heading:
        relative = segment_errors(segments, drives, matches, max_gap_s)
        heading_rms = rms_spread(segments, solution, replicates, confidence, slice(2, 3)).intervals
    faults = tuple(fault_notes(segments, solution, check))
    between = between_drives(segments, solution, std_errors)
    return NoiseFit(
        noise=replace(noise, **between),
        between_drives=between,
        intervals=found.intervals,
        std_errors=std_errors,
        confidence=confidence,
        truth_position_std_m=sqrt(truth.position_var),
        truth_heading_std=sqrt(truth.heading_var),
        check=check,
        held_out=check_segments(segments, held_out(segments, solution), again),
        relative_errors=relative,
        heading_rms_intervals=heading_rms,
        counts=sum((m.counts for m in matches), MatchCounts()),
        time_offsets_s=tuple(m.time_offset_s for m in matches),
        heading_offsets=tuple(m.heading_offset for m in matches),
        tracks=tuple(laid_on_truth(part) for part in segments.resampled),
        faults=faults,
        notes=(
            *faults,
            *(note for pair in drives for recording in pair for note in recording.notes),
            *notes,
            *data_notes(drives, matches, segments, truth, check),
            *drive_notes(segments, solution, std_errors),
            *check.notes,
        ),
        _fitted=(solution.names, solution.theta),
        _replicates=replicates,
    )


class Estimated(NamedTuple):
    """The estimate, its bootstrap, spread as far as Student's quantile calls for, and by the names of the rates what it
    says of them: percentile intervals hold the estimate, and no negative variance."""

    solution: Solution
    replicates: Floats
    std_errors: dict[str, float]
    intervals: dict[str, tuple[float, float]]


def estimated(
    segments: SegmentSet, names: tuple[str, ...], confidence: float, resamples: int, seed: int
) -> tuple[Estimated, list[str]]:
    """The rates and how well they are known, and what there is to say of those left out."""
    solution, notes = _solved(segments, names)
    replicates, blocks = bootstrap(segments, solution, resamples, np.random.default_rng(seed))
    error, theta, tail = replicates.std(axis=0), solution.theta, (1 - confidence) / 2
    replicates = theta + student_allowance(blocks, tail) * (replicates - theta)
    low, high = np.quantile(replicates, [tail, 1 - tail], axis=0)
    low, high = np.minimum(np.where(solution.bounded, np.maximum(low, 0.0), low), theta), np.maximum(high, theta)
    rates = [k for k, name in enumerate(solution.names) if name not in TRUTH]
    std_errors = {solution.names[k]: float(error[k]) for k in rates}
    held = {solution.names[k]: (float(low[k]), float(high[k])) for k in rates}
    return Estimated(solution, replicates, std_errors, held), notes


def _solved(segments: SegmentSet, names: tuple[str, ...]) -> tuple[Solution, list[str]]:
    """The estimate, without what cannot be told from the rest, and what there is to say about it."""
    notes: list[str] = []
    turning = [name for name in names if name.endswith("_per_rad")]
    turned, longest = segments.turned_per_longest, segments.bins[-1].length_m
    if turning and turned < _STRAIGHT_RAD:
        names = tuple(name for name in names if name not in turning)
        notes.append(f"The robot hardly turned ({turned:.2g} rad per {longest:.3g} m): no rate per radian is fitted.")
    truth = TRUTH if segments.has_heading else TRUTH[:1]
    start = None
    for most_steps in (_FIRST_LOOK, _MOST_STEPS):  # what cannot be told apart would take long to converge
        while True:
            solution = solve(segments, [*names, *truth], most_steps, start)
            inflation = solution.variance_inflation()
            worst = max((name for name in names if name in turning), key=lambda n: inflation.get(n, 0.0), default="")
            if inflation.get(worst, 0.0) < _COLLINEAR:
                start = solution.theta
                break
            names, start = tuple(name for name in names if name != worst), None
            notes.append(f"These drives turn evenly: {worst} cannot be told from the rate per metre, and is left out.")
    if not solution.converged:
        return solution, notes
    fitted_cov = systematic_covariance(segments, solution)
    return solve(segments, solution.names, _MOST_STEPS, solution.theta, fitted_cov), notes
