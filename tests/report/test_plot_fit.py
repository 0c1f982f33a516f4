"""Figures of a fit show the numbers of the fit."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from driftplan.model.calibration.fit import fit_noise
from driftplan.model.calibration.recordings import simulate_log
from driftplan.model.noise import OdometryNoise
from driftplan.report.figures.fits import plot_coverage, plot_fit, plot_growth, plot_predicted

NOISE = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3)
PATH = 10 * [(0, 0), (6, 0), (6, 4), (1, 4)]


@pytest.fixture(scope="module")
def fit():
    few = ("distance_scale_error", "heading_var_per_m", "distance_var_per_m")
    return fit_noise(*simulate_log(PATH, NOISE), parameters=few, resamples=100)


@pytest.fixture(scope="module")
def other(fit):
    return fit.check_on(*simulate_log(PATH, NOISE, rng=1))


def axes():
    return Figure().subplots()


def points(container):
    return container.lines[0].get_xydata()


def test_growth_shows_measured_errors_and_the_fit_with_its_interval(fit, other):
    ax = axes()
    mine, its = plot_growth(fit, {"other": other}, ax=ax)
    for drawn, check in ((mine, fit.check), (its, other)):
        assert points(drawn) == pytest.approx(np.array([(r.length_m, r.measured_rms_m) for r in check.lengths]))
    (curve,) = [line for line in ax.lines if line.get_label() == "predicted"]
    predicted = np.array([row.predicted_rms_m for row in fit.check.lengths])
    assert curve.get_ydata() == pytest.approx(predicted)
    low, high = np.transpose([row.predicted_rms_interval_m for row in fit.check.lengths])
    assert (low < predicted).all()
    assert (predicted < high).all()
    dots = np.concatenate([line.get_ydata() for line in ax.lines if line.get_marker() == "."])
    assert set(dots) <= set(np.concatenate(fit.check.errors_m))
    for row, errors in zip(fit.check.lengths, fit.check.errors_m, strict=True):
        assert np.sqrt(np.mean(errors**2)) == pytest.approx(row.measured_rms_m)
        assert len(errors) == row.segments
    (band,) = ax.collections[:1]
    assert band.get_datalim(ax.transData).ymax == pytest.approx(high.max())
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("length of segment (m)", "rms position error (m)")


def test_heading_errors_are_in_degrees(fit):
    (drawn,) = plot_growth(fit, heading=True, ax=axes())
    expected = [np.degrees(row.measured_heading_rms) for row in fit.check.lengths]
    assert points(drawn)[:, 1] == pytest.approx(expected)
    alone = fit_noise(*simulate_log(PATH, NOISE), use_heading=False, resamples=100)
    with pytest.raises(ValueError, match="expected a fit with measured headings"):
        plot_growth(alone, heading=True, ax=axes())


def test_predicted_and_measured_meet_on_the_line(fit, other):
    ax = axes()
    drawn = plot_predicted({"fit": fit.check, "other": other}, ax=ax)
    expected = [(row.predicted_rms_m, row.measured_rms_m) for row in other.lengths]
    assert points(drawn[1]) == pytest.approx(np.array(expected))
    assert ax.get_aspect() == 1.0


def test_coverage_is_shown_with_the_error_that_chance_allows(fit):
    drawn = plot_coverage({"fit": fit.check}, ax=axes())
    assert len(drawn) == 3
    for k, container in enumerate(drawn):
        assert points(container)[:, 1] == pytest.approx([100 * row.coverage[k] for row in fit.check.lengths])
        bars = container.lines[2][0].get_segments()
        spans = [bar[1, 1] - bar[0, 1] for bar in bars]
        assert spans == pytest.approx([400 * row.coverage_error[k] for row in fit.check.lengths])


def test_the_whole_figure_has_a_panel_for_each_question(fit, other):
    before = {name: mpl.rcParams[name] for name in ("figure.figsize", "font.size", "axes.grid", "lines.linewidth")}
    figure = plot_fit(fit, {"other": other})
    assert len(figure.axes) == 5
    assert all(ax.get_title() for ax in figure.axes)
    true, estimated = fit.tracks[0]
    assert figure.axes[0].lines[0].get_xdata() == pytest.approx(true.real)
    assert abs(estimated[0] - true[0]) < 1e-9
    assert [text.get_text() for text in figure.legends[0].get_texts()][-1] == "measured: other"
    assert {name: mpl.rcParams[name] for name in before} == before
    mine = Figure()
    assert plot_fit(fit, figure=mine) is mine


def test_seven_drives_are_told_apart(fit, other):
    ax = axes()
    drives = {f"drive {k}": other for k in range(6)}
    drawn = plot_growth(fit, drives, ax=ax)
    looks = {(c.lines[0].get_color(), c.lines[0].get_marker()) for c in drawn}
    assert len(looks) == len({colour for colour, _ in looks}) == 7
    curves = [line for line in ax.lines if len(line.get_xdata()) == len(other.lengths) and line.get_linewidth() == 0.9]
    for curve in curves:  # every other drive's own prediction
        assert curve.get_ydata() == pytest.approx([row.predicted_rms_m for row in other.lengths])
    assert len(curves) == 6
    assert len(plot_coverage({"fit": fit.check, **drives}, ax=axes())) == 7  # at one level: 21 lines cannot be read


@pytest.mark.parametrize("plot", [plot_coverage, plot_predicted])
def test_no_drives_are_refused(plot):
    with pytest.raises(ValueError, match="one drive or more"):
        plot({}, ax=axes())
