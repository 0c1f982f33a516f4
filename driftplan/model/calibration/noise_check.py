"""check_noise: does a noise, fitted or given, describe the errors of recorded segments? Predicted against measured.

Segments overlap, share turns and have errors of very different sizes, so that textbook standard errors of their mean
squares and shares are wrong by factors. So the drives are repeated at their own knots with Gaussian errors of the
model, and whatever a check computes is computed of every repetition: what chance alone does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats
from driftplan.model.calibration.matched_drive import MatchOptions
from driftplan.model.calibration.quasi_likelihood import SYSTEMATIC, RmsSpread, systematic_errors
from driftplan.model.calibration.recordings import OdometryLog, Trajectory
from driftplan.model.calibration.segment_sets import SegmentSet, drives_of, segment_set
from driftplan.model.calibration.segments import TruthNoise, errors_of, repeated
from driftplan.model.noise import BETWEEN_DRIVES, OdometryNoise
from driftplan.tables import Tabular, decimals, table

Estimate = OdometryLog | ArrayLike
Truth = Trajectory | ArrayLike

LEVELS = (0.5, 0.9, 0.95)
LIMITS = tuple(float(-2 * np.log1p(-level)) for level in LEVELS)  # of χ² with two degrees of freedom
CLEAR_CHANCE = 0.01  # that a right model is said not to fit
HEAVY_TAILS_CHANCE = 0.05  # that Gaussian errors are said not to be so
_CLEAR_SHIFT_ERRORS = 3.0  # standard errors by which the systematic errors of other drives are said to differ
_TRUSTED = 0.35  # of the predicted rms, within which the measured one has to be
_CLEAR_RATIO = 0.15  # of the predicted rms, by which the measured one is at least off if it is said to be
_REPETITIONS = 199
_NUMBERS_AT_ONCE = 4_000_000


class LengthCheck(NamedTuple):
    """Segments of one length.

    Attributes
    ----------
    length_m : with positions alone the first half serves to align, and the errors are those of the second half's end
    segments : overlapping ones
    independent : how many fit side by side
    measured_rms_m, predicted_rms_m : root mean square position error, with the white errors of the reference in both
    measured_rms_error_m : standard error of the measured one
    predicted_rms_interval_m : of the predicted one, by the fit's intervals; the prediction twice for a noise given
    measured_heading_rms, predicted_heading_rms : of the sine of the heading error gained; nan without true headings
    coverage : share of the errors inside the regions that should hold 50, 90 and 95 %
    coverage_error : standard deviations of these shares if the model were right
    mean_nees : mean normalised error squared per degree of freedom: 1 if right, above if the model promises too much
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
class SegmentCheck(Tabular):
    """What `fit_noise` and `check_noise` found at each length, and what to make of it.

    Attributes
    ----------
    lengths : shortest first
    errors_m : position errors of all segments, metres, by length
    has_heading : whether segments were aligned by measured headings
    notes : plain sentences; empty when the model describes the errors within sampling errors
    """

    lengths: tuple[LengthCheck, ...]
    errors_m: tuple[Floats, ...]
    has_heading: bool
    notes: tuple[str, ...]

    @property
    def fits(self) -> bool:
        """Whether nothing speaks against the model."""
        return not self.notes

    @property
    def trust(self) -> str:
        """How far a fit may be trusted on these drives, by length, in one sentence."""
        ratios = [(row, row.measured_rms_m / max(row.predicted_rms_m, 1e-300)) for row in self.lengths]
        held = [f"{row.length_m:.3g}" for row, ratio in ratios if abs(ratio - 1) <= _TRUSTED]
        off = [(f"{ratio:.2f}", f"{row.length_m:.3g}") for row, ratio in ratios if abs(ratio - 1) > _TRUSTED]
        verdicts = [f"within {100 * _TRUSTED:.0f} % of the predicted one at {', '.join(held)} m"] if held else []
        if off:
            times, lengths = (", ".join(words) for words in zip(*off, strict=True))
            verdicts.append(f"{times} times {'it' if held else 'the predicted one'} at {lengths} m")
        shares = [100 * row.coverage[1] for row in self.lengths]
        return (
            f"The rms of these drives is {' and '.join(verdicts)}; the 90 % regions hold {min(shares):.0f} to "
            f"{max(shares):.0f} % of their errors."
        )

    def to_dicts(self) -> list[dict[str, Any]]:
        """One row per length, by the names of `LengthCheck`."""
        return [row._asdict() for row in self.lengths]

    def columns(self) -> dict[str, list[str]]:
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
        return columns

    def __str__(self) -> str:
        head = "errors of segments, measured and predicted; shares inside the predicted regions (± 2 standard errors)"
        return f"{head}\n{table(self.columns())}"


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

    >>> from driftplan.model.calibration.recordings import simulate_log
    >>> noise = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3)
    >>> check = check_noise(noise, *simulate_log(5 * [(0, 0), (5, 0), (5, 5), (0, 5)], noise, rng=1))
    >>> [bool(0.5 < row.measured_rms_m / row.predicted_rms_m < 2) for row in check.lengths[:3]]
    [True, True, True]
    """
    if noise.step_m is not None or noise.heading_distance_corr != 0:
        raise ValueError(f"expected a noise of the continuous model without heading_distance_corr, got {noise!r}")
    offsets: MatchOptions = {"time_offset_s": time_offset_s, "heading_offset": heading_offset, "max_gap_s": max_gap_s}
    drives = drives_of(estimates, truths)
    segments, _ = segment_set(drives, lengths_m=lengths_m, use_heading=use_heading, **offsets)
    return checked(segments, noise, TruthNoise(truth_position_std_m**2, truth_heading_std**2))


def checked(
    segments: SegmentSet, noise: OdometryNoise, truth: TruthNoise, spread: RmsSpread | None = None
) -> SegmentCheck:
    """The check of a noise, and what it says of systematic errors; for a fit within what it knows."""
    mean, cov = segments.expected(segments.windows(noise), truth)
    values, slopes = systematic_errors(segments, noise.on_drive((0, 0, 0)), truth)
    between = {name: getattr(noise, std) for name, std in BETWEEN_DRIVES.items()}
    variances = np.array([between[name] for name in SYSTEMATIC]) ** 2
    cov = cov + np.einsum("nki,k,nkj->nij", slopes, variances, slopes)
    notes = _systematic_notes(noise, values, between)
    intervals, errors = (None, None) if spread is None else spread
    return check_segments(segments, (mean, cov), repetitions(segments, noise, truth), intervals, errors, notes)


def repetitions(segments: SegmentSet, noise: OdometryNoise, truth: TruthNoise) -> Floats:
    """The observed values of all segments, (runs, n, 3), if the drives are driven again under a noise."""
    rng = np.random.default_rng(0)
    knots = sum(len(part.driven) for part in segments.resampled)
    chunk = int(np.clip(_NUMBERS_AT_ONCE // (knots + len(segments.values)), 1, _REPETITIONS))
    found = []
    for begin in range(0, _REPETITIONS, chunk):
        runs = min(chunk, _REPETITIONS - begin)
        deviations = rng.standard_normal((3, runs)) if noise.varies_between_drives else np.zeros((3, runs))
        drives = [repeated(part, noise, truth, rng, deviations) for part in segments.resampled]
        observed = [(drives[i], seen.starts, length.steps) for length in segments.bins for i, seen in length.observed]
        found.append(np.concatenate([errors_of(*one) for one in observed], axis=-2))
    return np.concatenate(found)


def _figures(segments: SegmentSet, values: Floats, mean: Floats, cov: Floats) -> tuple[Floats, ...]:
    """What a check measures of observed values (..., n, 3) with these moments: mean square position errors (...,
    lengths), m²; shares inside the regions (..., lengths, levels); mean normalised squares; and the logarithm of their
    median over it, -0.37 if Gaussian, lower where few hold most."""
    where = segments.position
    square, surplus = (values[..., where] ** 2).sum(axis=-1), values[..., where] - mean[:, where]
    nees = np.einsum("...ni,nij,...nj->...n", surplus, np.linalg.inv(cov[:, where, where]), surplus)
    found = []
    for k in range(len(segments.bins)):
        mine = segments.bin_of == k
        some, typical = nees[..., mine], nees[..., mine].mean(axis=-1)
        shares = np.stack([(some < limit).mean(axis=-1) for limit in LIMITS], axis=-1)
        tails = np.log(np.maximum(np.median(some, axis=-1), 1e-300) / np.maximum(typical, 1e-300))
        found.append((square[..., mine].mean(axis=-1), shares, typical, tails))
    squares, all_shares, *others = zip(*found, strict=True)
    return np.stack(squares, axis=-1), np.stack(all_shares, axis=-2), *(np.stack(x, axis=-1) for x in others)


def check_segments(
    segments: SegmentSet,
    moments: tuple[Floats, Floats],
    repeated_values: Floats,
    rms_intervals_m: Floats | None = None,
    rms_errors_m: Floats | None = None,
    notes: Sequence[str] = (),
) -> SegmentCheck:
    """The errors of segments against ``moments`` (n, 3), (n, 3, 3) that are predicted for them, and what chance does in
    `repetitions`. ``rms_intervals_m`` (lengths, 2) of the predicted rms are told; where the prediction owes nothing to
    these segments, the standard errors of its rms (lengths,) count too. ``notes`` come before those on misfits."""
    mean, cov = moments
    cov = cov + segments.floor()[segments.bin_of]
    where = segments.position
    square, shares, nees, tails = _figures(segments, segments.values, mean, cov)
    squares, all_shares, _, all_tails = _figures(segments, repeated_values, mean, cov)
    log_rms, share_errors = 0.5 * np.log(np.maximum(squares, 1e-300)), all_shares.std(axis=0)
    errors_m = np.sqrt((segments.values[:, where] ** 2).sum(axis=1))
    rms, heading = np.sqrt(square), mean[:, 2] ** 2 + cov[:, 2, 2]
    predicted = (mean[:, where] ** 2).sum(axis=1) + np.trace(cov[:, where, where], axis1=1, axis2=2)
    predicted_rms, gained, predicted_gained = (
        np.sqrt(segments.by_bin(x)).tolist() for x in (predicted, segments.values[:, 2] ** 2, heading)
    )
    lengths = []
    for k, length in enumerate(segments.bins):
        mine = segments.bin_of == k
        scatter = _mean_error(errors_m[mine] ** 2, segments.place_m[mine], length.length_m) / max(2 * rms[k], 1e-300)
        lengths.append(
            LengthCheck(
                length.length_m,
                int(mine.sum()),
                max(segments.total_m / length.length_m, 1.0),
                float(rms[k]),
                predicted_rms[k],
                max(scatter, float(log_rms[:, k].std() * rms[k])),
                *((predicted_rms[k], predicted_rms[k]) if rms_intervals_m is None else rms_intervals_m[k].tolist(),),
                gained[k] if segments.has_heading else float("nan"),
                predicted_gained[k] if segments.has_heading else float("nan"),
                tuple(shares[k].tolist()),
                tuple(share_errors[k].tolist()),
                float(nees[k] / 2),
            )
        )
    standard, heaviest = _standard(tails, all_tails), _standard(all_tails).min(axis=1)
    as_heavy = float((1 + (heaviest <= standard.min()).sum()) / (1 + len(heaviest)))  # chance at some length
    found = (
        growth_note(lengths, _clear(np.abs(_standard(log_rms)).max(axis=1)), rms_errors_m),
        _tails_note(lengths[int(np.argmin(standard))], as_heavy)
        or _regions_note(lengths, _clear(-_standard(all_shares[..., -1]).min(axis=1)), rms_errors_m),
    )
    return SegmentCheck(
        lengths=tuple(lengths),
        errors_m=tuple(errors_m[segments.bin_of == k] for k in range(len(lengths))),
        has_heading=segments.has_heading,
        notes=(*notes, *(note for note in found if note)),
    )


def _standard(values: Floats, chance: Floats | None = None) -> Floats:
    """Values (..., lengths) in the standard deviations that chance (runs, lengths) gives them, by default their own."""
    chance = values if chance is None else chance
    return np.asarray((values - chance.mean(axis=0)) / np.maximum(chance.std(axis=0), 1e-12))


def _clear(worst: Floats) -> float:
    """Standard errors, 3 at least, that the worst length exceeds in `CLEAR_CHANCE` of all checks of a right model."""
    return max(3.0, float(np.quantile(worst, 1 - CLEAR_CHANCE)))


def _mean_error(values: Floats, place_m: Floats, length_m: float) -> float:
    """Standard error of a mean over overlapping segments: from the means of blocks of two segments' length."""
    block = np.floor(place_m / (2 * length_m)).astype(int)
    _, block = np.unique(block, return_inverse=True)
    count = np.bincount(block)
    if len(count) < 3:
        return float(values.std())
    surplus = np.bincount(block, values - values.mean())
    return float(np.sqrt((surplus**2).sum() * len(count) / (len(count) - 1)) / len(values))


def growth_note(rows: Sequence[LengthCheck], clear_errors: float, rms_errors_m: Floats | None = None) -> str:
    """How the rms grows with length, measured over predicted, where they differ by more than ``clear_errors``."""
    measured, predicted, error = (
        np.array([getattr(row, name) for row in rows])
        for name in ("measured_rms_m", "predicted_rms_m", "measured_rms_error_m")
    )
    ratio, error = np.maximum(measured, 1e-300) / predicted, error / np.maximum(measured, 1e-300)
    # as chance was measured, of logarithms: theirs is a mean too low by the error squared, where the square's is right
    shift = np.abs(np.log(ratio) + error**2)
    clear = shift > clear_errors * np.hypot(error, 0.0 if rms_errors_m is None else rms_errors_m / predicted)
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


def _tails_note(row: LengthCheck, chance: float) -> str:
    """Whether few segments hold most of the error, most clearly at one length; Gaussian errors do with this chance."""
    if chance > HEAVY_TAILS_CHANCE:
        return ""
    outside = 1 - row.coverage[2]
    tails = f" and {100 * outside:.0f} % outside the 95 % region" if outside > 1 - LEVELS[2] else ""
    narrow = " and too narrow for the rest" if tails else ""
    return (
        f"The errors are not Gaussian: {100 * row.coverage[0]:.0f} % lie inside the 50 % region{tails} at "
        f"{row.length_m:.3g} m. Most of the drift comes from a few places (slips?): the rms may hold, the regions "
        f"are too wide for most segments{narrow}. (Gaussian errors look so in {100 * chance:.2g} % of fits.)"
    )


def _regions_note(rows: Sequence[LengthCheck], clear_errors: float, rms_errors_m: Floats | None) -> str:
    """Whether more errors fall outside the widest region than ``clear_errors`` of that share explain."""
    share, error = (np.array([getattr(row, name)[2] for row in rows]) for name in ("coverage", "coverage_error"))
    if rms_errors_m is not None:  # regions too large or small by a share p hold χ² exp(-χ²/2) p less or more of χ²
        relative = rms_errors_m / [row.predicted_rms_m for row in rows]
        error = np.hypot(error, relative * LIMITS[2] * np.exp(-0.5 * LIMITS[2]))
    excess = (share - LEVELS[2]) / np.maximum(error, 1e-12)
    if not (excess < -clear_errors).any():
        return ""
    row = rows[int(np.argmin(excess))]
    return (
        f"The regions are too small: {100 * (1 - row.coverage[2]):.0f} % of the errors lie outside the 95 % region "
        f"at {row.length_m:.3g} m."
    )


def _systematic_notes(
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
