"""Layouts side by side, and results as notebooks and pandas show them."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.layouts.layout import compare_layouts
from driftplan.layouts.place import place_beacons
from driftplan.layouts.scenario import Sites
from driftplan.model.noise import OdometryNoise
from driftplan.planning.request import DriftLimit

NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
SIGN = replace(BeaconKind.landmark(2.0, 0.05, 0.01, line_of_sight=False), name="<sign>")
ROUTE = np.array([(0, 0), (40, 0), (40, 20)], dtype=float)
OLD = Beacon(SIGN, 60.0, 60.0, id="old")


@pytest.fixture(scope="module")
def layouts():
    sites = Sites(SIGN, spacing_m=4.0, existing=[OLD])
    return {
        "lean": place_beacons(None, ROUTE, NOISE, 0.8, sites),
        "one may die": place_beacons(None, ROUTE, NOISE, DriftLimit(0.8, redundancy=2), sites),
    }


def test_layouts_are_compared_by_what_they_cost_and_keep(layouts):
    found = compare_layouts(layouts)
    lean, sturdy = found.rows
    assert (lean["name"], sturdy["name"]) == ("lean", "one may die")
    assert lean["beacons"] == len(layouts["lean"].beacons) < sturdy["beacons"]
    assert sturdy["worst_single_failure_m"] <= 0.8 < lean["worst_single_failure_m"]
    assert lean["route_m"] == 60.0
    frame = found.to_pandas()
    assert list(frame["worst_drift_m"]) == [layout.worst_drift for layout in layouts.values()]
    assert str(found).splitlines()[0].split()[:3] == ["layout", "beacons", "cost"]
    assert found._repr_html_().count("<tr>") == 3


def test_without_beacons_there_is_no_failure():
    (row,) = compare_layouts({"none": place_beacons(None, ROUTE, NOISE, 50.0, SIGN)}).rows
    assert (row["beacons"], np.isnan(row["worst_single_failure_m"])) == (0, True)


@pytest.mark.parametrize("nothing", [{}, [], {"a": 3}, "ab"])
def test_what_is_no_layout_is_refused(nothing):
    with pytest.raises(ValueError, match="expected layouts by name"):
        compare_layouts(nothing)


def test_a_layout_has_a_row_per_beacon_in_pandas_and_in_notebooks(layouts):
    layout = layouts["lean"]
    frame = layout.to_pandas()
    assert list(frame["id"]) == ["old", *(b.id for b in layout.beacons)]
    assert list(frame["new"]) == [False] + [True] * len(layout.beacons)
    shown = layout._repr_html_()
    assert shown.count("<tr>") == 2 + len(layout.beacons)
    assert "&lt;sign&gt; (existing)" in shown
    assert "<sign>" not in shown


def test_without_pandas_the_message_says_what_to_install(layouts, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="pip install pandas"):
        layouts["lean"].to_pandas()
