"""Figures of a noise fit: how errors grow with length, measured and predicted, and how many lie where they should."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from driftplan.arrays import Floats
from driftplan.model.calibration.fit import NoiseFit
from driftplan.model.calibration.noise_check import LEVELS, SegmentCheck
from driftplan.report.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.container import ErrorbarContainer
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

FITTED = "the drives of the fit"
_MAX_DOTS = 400  # of single segments, per length
_MAX_ALL_LEVELS = 2  # drives of which the shares in all regions are shown; of more, those in one
_MARKERS = "os^vDPX*"


def _looks(count: int) -> list[dict[str, str]]:
    """Colour and marker of every drive, of which there must be one: no two alike."""
    if count == 0:
        raise ValueError("expected the check of one drive or more, got none")
    looks = zip(range(count), cycle(style.MANY_COLOURS), cycle(_MARKERS), strict=False)
    return [{"color": colour, "marker": marker} for _, colour, marker in looks]


def plot_fit(
    fit: NoiseFit, others: Mapping[str, SegmentCheck] | None = None, *, figure: Figure | None = None
) -> Figure:
    """A fit in four or five panels: the track, position error (and heading error) against length, predicted against
    measured rms, and the shares of errors inside the predicted regions.

    Parameters
    ----------
    others : mapping of label to SegmentCheck, optional: checks of the fit on other drives, from `NoiseFit.check_on`

    >>> from driftplan import OdometryNoise, fit_noise, simulate_log
    >>> drive = 5 * [(0, 0), (5, 0), (5, 5), (0, 5)]
    >>> fit = fit_noise(*simulate_log(drive, OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3), rng=1))
    >>> len(plot_fit(fit).axes)
    5
    """
    checks = {FITTED: fit.check, **(others or {})}
    headed, rows = fit.check.has_heading, fit.check.lengths
    panels = 5 if headed else 4
    figure = style.new_figure(figure, 4.2 * panels, 4.8)
    axes = list(figure.subplots(1, panels))
    plot_tracks(fit, ax=axes[0])
    plot_growth(fit, others, ax=axes[1])
    if headed:
        plot_growth(fit, others, heading=True, ax=axes[2])
    plot_predicted(checks, ax=axes[-2])
    plot_coverage(checks, ax=axes[-1])
    ratios = [row.measured_rms_m / row.predicted_rms_m for row in rows]
    factor = max(*ratios, *(1 / ratio for ratio in ratios))
    held = [100 * row.coverage[1] for row in rows]
    titles = ["where it drove", "position", *(["heading"] if headed else [])]
    titles += [f"as predicted within {100 * (factor - 1):.0f} %"]
    titles += [f"the 90 % regions hold {min(held):.0f} to {max(held):.0f} %"]
    for ax, title in zip(axes, titles, strict=True):
        ax.set_title(title)
    style.legend_below(figure, [*axes[0].get_legend_handles_labels()[0], *axes[1].get_legend_handles_labels()[0]])
    return figure


def plot_tracks(fit: NoiseFit, *, ax: Axes | None = None) -> list[Line2D]:
    """Draw the true way of the fitted drives, and the odometry laid on its beginning."""
    ax = style.current_axes(ax)
    drawn: list[Line2D] = []
    looks = (("truth", "0.65", 2.0), ("odometry", style.MANY_COLOURS[0], 0.9))
    for k, tracks in enumerate(fit.tracks):
        for track, (label, colour, width) in zip(tracks, looks, strict=True):
            drawn += ax.plot(track.real, track.imag, color=colour, linewidth=width, label=None if k else label)
    style.in_metres(ax)
    ax.set_aspect("equal", adjustable="datalim")
    return drawn


def plot_growth(
    fit: NoiseFit, others: Mapping[str, SegmentCheck] | None = None, *, heading: bool = False, ax: Axes | None = None
) -> list[ErrorbarContainer]:
    """Draw the errors of segments against their length: all of them as dots, their rms with two standard errors, and
    the fitted curve with its interval; other drives beside the curve that is predicted for them.

    Parameters
    ----------
    others : mapping of label to SegmentCheck, optional: checks on other drives
    heading : the heading error gained (degrees) instead of the position error (metres)
    """
    ax = style.current_axes(ax)
    bands = fit.heading_rms_intervals if heading else np.array([r.predicted_rms_interval_m for r in fit.check.lengths])
    if bands is None:
        raise ValueError("expected a fit with measured headings, got one of positions alone")
    unit = np.degrees(1.0) if heading else 1.0
    length = [row.length_m for row in fit.check.lengths]
    interval = f"{100 * fit.confidence:g} % interval of the fit"
    ax.fill_between(length, *(unit * bands.T), color="0.85", zorder=1, label=interval)
    predicted = unit * _rms("predicted", fit.check, heading)
    ax.plot(length, predicted, color="black", linewidth=1.5, zorder=2, label="predicted")
    if not heading:
        _dots(fit.check, ax)
    drawn = []
    checks = {FITTED: fit.check, **(others or {})}
    for (label, check), own in zip(checks.items(), _looks(len(checks)), strict=True):
        if check is not fit.check:  # its way turns otherwise, and so it has a prediction of its own
            lengths = [row.length_m for row in check.lengths]
            ax.plot(lengths, unit * _rms("predicted", check, heading), color=own["color"], linewidth=0.9, zorder=2)
        errors = None if heading else [2 * row.measured_rms_error_m for row in check.lengths]
        x, y = [row.length_m for row in check.lengths], unit * _rms("measured", check, heading)
        drawn.append(_points(ax, own, f"measured: {label}", x, y, yerr=errors, zorder=3))
    aligned = "" if fit.check.has_heading else " (first half to align)"
    what = "rms heading error (deg)" if heading else "rms position error (m)"
    ax.set(xscale="log", yscale="log", xlabel=f"length of segment (m){aligned}", ylabel=what)
    _tidy(ax)
    return drawn


def _dots(check: SegmentCheck, ax: Axes) -> None:
    """Position errors of single segments, moved aside a little so that they do not hide each other; the smallest
    hundredth, which a logarithmic axis would stretch for, is left out."""
    rng = np.random.default_rng(0)
    for row, errors in zip(check.lengths, check.errors_m, strict=True):
        shown = rng.permutation(errors[errors >= np.quantile(errors, 0.01)])[:_MAX_DOTS]
        aside = row.length_m * np.exp(rng.uniform(-0.15, 0.15, len(shown)))
        label = "single segments" if row is check.lengths[0] else None
        ax.plot(aside, shown, ".", color="0.6", markersize=2, alpha=0.5, zorder=1.5, rasterized=True, label=label)


def plot_predicted(checks: Mapping[str, SegmentCheck], *, ax: Axes | None = None) -> list[ErrorbarContainer]:
    """Draw measured against predicted rms position errors, a point per length, with two standard errors upright and the
    fit's interval across; on the line they agree, and between the dotted ones within a quarter.

    >>> from matplotlib.figure import Figure
    >>> from driftplan import OdometryNoise, fit_noise, simulate_log
    >>> drive = simulate_log(5 * [(0, 0), (5, 0), (5, 5), (0, 5)], OdometryNoise(heading_var_per_m=1e-3), rng=1)
    >>> fit = fit_noise(*drive, parameters=["heading_var_per_m"], resamples=100)
    >>> len(plot_predicted({"fitted": fit.check}, ax=Figure().subplots()))
    1
    """
    ax = style.current_axes(ax)
    drawn, sizes = [], []
    for (label, check), own in zip(checks.items(), _looks(len(checks)), strict=True):
        predicted, measured = (_rms(which, check, False) for which in ("predicted", "measured"))
        sizes += [*predicted, *measured]
        upright = [2 * row.measured_rms_error_m for row in check.lengths]
        low, high = np.transpose([row.predicted_rms_interval_m for row in check.lengths])
        across = np.maximum([predicted - low, high - predicted], 0.0)
        drawn.append(_points(ax, own, label, predicted, measured, yerr=upright, xerr=across, elinewidth=0.8))
    ends = np.array([0.8 * min(sizes), 1.25 * max(sizes)])
    ax.plot(ends, ends, color="black", linewidth=1.0, zorder=1)
    for factor in (0.8, 1.25):
        ax.plot(ends, factor * ends, color="0.5", linewidth=0.8, linestyle=":", zorder=1)
    ax.set(xscale="log", yscale="log", xlabel="predicted rms (m)", ylabel="measured rms (m)", aspect="equal")
    _tidy(ax)
    return drawn


def plot_coverage(checks: Mapping[str, SegmentCheck], *, ax: Axes | None = None) -> list[ErrorbarContainer]:
    """Draw, against length, the shares of errors inside the regions that should hold 50, 90 and 95 %, with the two
    standard errors that chance allows about each; of more than two drives, the region of 90 % alone.

    >>> from matplotlib.figure import Figure
    >>> from driftplan import OdometryNoise, fit_noise, simulate_log
    >>> drive = simulate_log(5 * [(0, 0), (5, 0), (5, 5), (0, 5)], OdometryNoise(heading_var_per_m=1e-3), rng=1)
    >>> fit = fit_noise(*drive, parameters=["heading_var_per_m"], resamples=100)
    >>> len(plot_coverage({"fitted": fit.check}, ax=Figure().subplots()))
    3
    """
    ax = style.current_axes(ax)
    drawn = []
    lines: dict[int, Any] = {0: "-", 1: "--", 2: ":"} if len(checks) <= _MAX_ALL_LEVELS else {1: "-"}
    look: dict[str, Any] = {"color": "0.4", "linewidth": 0.8, "zorder": 1}
    keys = [
        ax.axhline(100 * LEVELS[k], linestyle=line, label=f"{100 * LEVELS[k]:g} %", **look) for k, line in lines.items()
    ]
    for (label, check), own in zip(checks.items(), _looks(len(checks)), strict=True):
        aside = 1.02 ** (2 * list(checks).index(label) - len(checks))  # so that bars do not hide each other
        length = [row.length_m * (aside if len(checks) > 1 else 1.0) for row in check.lengths]
        for k, line in lines.items():
            share = [100 * row.coverage[k] for row in check.lengths]
            chance = [200 * row.coverage_error[k] for row in check.lengths]
            name = f"{label}: {100 * LEVELS[k]:g} %"
            drawn.append(_points(ax, own, name, length, share, yerr=chance, linestyle=line, linewidth=1.0))
    what = "region" if len(lines) > 1 else "90 % region"
    ax.set(xscale="log", xlabel="length of segment (m)", ylabel=f"inside the predicted {what} (%)", ylim=(0, 105))
    ax.legend(handles=keys, title="should hold", loc="lower right", fontsize=8)
    _tidy(ax)
    return drawn


def _points(ax: Axes, own: Mapping[str, Any], label: str, x: Any, y: Any, **bars: Any) -> ErrorbarContainer:
    """Points with error bars in the look of their drives."""
    look = {"color": own["color"], "marker": own["marker"], "linestyle": "none", "capsize": 2, **bars}
    return ax.errorbar(x, y, label=label, **look)


def _rms(which: str, check: SegmentCheck, heading: bool) -> Floats:
    """The "measured" or the "predicted" ones of every length."""
    return np.array([getattr(row, f"{which}_heading_rms" if heading else f"{which}_rms_m") for row in check.lengths])


def _tidy(ax: Axes) -> None:
    """Few and plain ticks on logarithmic axes, and a quiet grid."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis, scale in ((ax.xaxis, ax.get_xscale()), (ax.yaxis, ax.get_yscale())):
        if scale == "log":
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_formatter(NullFormatter())
    style.quiet_grid(ax)
