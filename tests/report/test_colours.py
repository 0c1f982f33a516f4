"""Colours are told apart by people who lack one of the three cones, and the routes' in grey too.

Seen without a cone: the linear maps of Machado, Oliveira & Fernandes, "A physiologically-based model for simulation of
color vision deficiency", IEEE TVCG 15(6), 2009, table 1, severity 1. Distances are Euclidean in CIE L*a*b* (D65);
two neighbouring patches are just told apart at 2.3, thin lines and small marks need several times that.
"""

from __future__ import annotations

import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from driftplan.report.figures import style

PACKAGE = Path(__file__).resolve().parents[2] / "driftplan"
SEEN = {
    "all cones": np.eye(3),
    "no long ones (protanopia)": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "no middle ones (deuteranopia)": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "no short ones (tritanopia)": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
ROUTES = tuple(own["color"] for own in style.ROUTE_STYLES)
REPORT = (PACKAGE / "report/study_report.html").read_text()
SERIES = re.findall(r"--c0: .*?; --c5: #\w+", REPORT)  # by day, by night


def linear(colour: str) -> np.ndarray:
    srgb = np.array(to_rgb(colour))
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def lab(colour: str, seen: str = "all cones") -> np.ndarray:
    light = np.clip(np.array(SEEN[seen]) @ linear(colour), 0, 1)
    xyz = XYZ @ light / (XYZ @ np.ones(3))
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def nearest(colours, seen: str) -> float:
    return min(float(np.linalg.norm(lab(a, seen) - lab(b, seen))) for a, b in combinations(colours, 2))


def test_the_scale_is_that_of_cie_lab():
    np.testing.assert_allclose(lab("#ffffff"), [100, 0, 0], atol=1e-9)
    np.testing.assert_allclose(lab("#ff0000"), [53.24, 80.09, 67.20], atol=0.02)  # as tabulated for sRGB
    for maps in SEEN.values():  # grey is grey to everyone
        np.testing.assert_allclose(np.sum(maps, axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("seen", SEEN)
@pytest.mark.parametrize(
    ("colours", "least"),
    [
        (ROUTES, 25.0),
        (style.MANY_COLOURS, 18.0),
        ((*ROUTES, style.BEACON_COLOUR), 15.0),
        ((style.BEACON_COLOUR, style.OTHER_BEACON_COLOUR, style.LIMIT["color"]), 10.0),
        *((re.findall(r"#\w+", line), 18.0) for line in SERIES),
    ],
    ids=["routes", "many", "routes and beacons", "beacons and limit", "study by day", "study by night"],
)
def test_no_two_colours_look_alike(seen, colours, least):
    assert nearest(colours, seen) > least


def test_routes_are_told_apart_in_grey_and_show_on_white():
    darkness = sorted(lab(colour)[0] for colour in ROUTES)
    assert np.diff(darkness).min() > 10
    luminance = [linear(colour) @ XYZ[1] for colour in ROUTES]
    assert min(1.05 / (0.05 + y) for y in luminance) >= 3  # the contrast that WCAG 2.2 asks of graphics, 3 : 1


def test_lines_that_are_told_apart_by_colour_differ_in_dash_and_marker_too():
    assert len({str(own["linestyle"]) for own in style.ROUTE_STYLES}) == len(style.ROUTE_STYLES)
    assert len({own["marker"] for own in style.ROUTE_STYLES}) == len(style.ROUTE_STYLES)


def test_the_worst_drift_is_the_darkest_in_grey():
    from driftplan.report.figures.layouts import _drift_colours

    grey = [lab(tuple(colour))[0] for colour in _drift_colours()(np.linspace(0, 1, 64))[:, :3]]
    assert (np.diff(grey) < 0).all()


def test_colours_of_figures_are_in_one_place():
    others = [file for file in (PACKAGE / "report").rglob("*.py") if file.name != "style.py"]
    assert [file.name for file in others if re.search(r"\"#[0-9A-Fa-f]{6}\"", file.read_text())] == []
