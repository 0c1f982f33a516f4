"""The page computes what Python computes, to 1e-9: the drift model is there twice, and this holds it together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan import Beacon, BeaconKind, Fix, OdometryNoise, World, Zone, drift_with_beacons
from driftplan.beacons.readings import BeaconColumns, readings_on
from driftplan.model.elements import of_legs
from driftplan.model.worst import worst_rms
from driftplan.page.scene import _rates, scene_of

CLOSE = 1e-9


def rates(**scale):
    """Noises of all continuous kinds, each rate present or not."""
    one = {
        "heading_var_per_m": 1e-3,
        "distance_var_per_m": 1e-2,
        "lateral_var_per_m": 1e-3,
        "heading_var_per_rad": 1e-2,
        "distance_var_per_rad": 1e-3,
        "heading_distance_corr": 1.0,
        "heading_bias_per_m": 1e-2,
        "heading_bias_per_rad": 0.05,
        "distance_scale_error": 0.1,
        **scale,
    }
    present = {name: st.one_of(st.just(0.0), st.floats(size * 1e-4, size)) for name, size in one.items()}
    return st.fixed_dictionaries(present).map(lambda said: OdometryNoise(**said))


def as_row(element):
    """Moments as the page has them."""
    pairs = (element.u, element.p, element.d1, element.d2)
    row = [part for x in pairs for part in (np.real(x), np.imag(x))] + [np.real(element.D)]
    row += [np.real(element.e1), np.imag(element.e1), np.real(element.N)]
    return np.array(row + [part for x in (element.e2, element.a, element.b) for part in (np.real(x), np.imag(x))])


@given(
    noise=rates(heading_var_per_m=1.0, heading_bias_per_m=1.0),
    turn=st.floats(-3.1, 3.1),
    length=st.floats(0, 100),
)
@settings(max_examples=100)
def test_moments_of_runs_and_turns(javascript, noise, turn, length):
    leg = of_legs(np.array(turn), np.array(length), np.array(0.0), np.array(0), [noise])
    ours = np.array(javascript("element", turn=turn, length=length, noise=_rates(noise)))
    expected = as_row(leg).astype(float)
    size = np.sqrt(max(expected[11], 1e-300))
    scale = np.array([1, 1, *[max(length, 1)] * 2, 1, 1, 1, 1, 1, size, size, size**2, size**2, size**2, *[size] * 4])
    assert np.abs(ours - expected) / scale == pytest.approx(0, abs=CLOSE)


KINDS = st.sampled_from(
    [
        BeaconKind.rfid(range_m=2.5, position_std_m=0.1),
        BeaconKind.rfid(range_m=4.0, position_std_m=0.05, detection_probability=0.7, std_per_m=0.02),
        BeaconKind.landmark(range_m=6.0, position_std_m=0.2, heading_std=0.01, reading_spacing_m=1.0),
        BeaconKind.landmark(range_m=5.0, position_std_m=0.1, heading_std=0.02, view_angle_deg=120, sensor_view_deg=90),
        BeaconKind.landmark(range_m=5.0, position_std_m=0.1, heading_std=0.02, view_angle_deg=270, sensor_view_deg=200),
        BeaconKind.heading(range_m=3.0, heading_std=0.02),
        BeaconKind.range_only(range_m=8.0, range_std_m=0.1, std_per_m=0.01),
        BeaconKind.bearing(range_m=8.0, bearing_std=0.02, detection_probability=0.9),
    ]
)
COORDINATE = st.one_of(st.integers(0, 20).map(float), st.floats(0, 20).map(lambda x: round(x, 4)))
POINT = st.tuples(COORDINATE, COORDINATE)
WALLS = [[(6, 3), (7, 3), (7, 12), (6, 12)], [(12, 8), (16, 9), (13, 11)], [(2, 15), (9, 15), (9, 15.3), (2, 15.3)]]


@st.composite
def scenes(draw):
    """A world, a path, a noise and beacons, and what the robot does with its readings."""
    estimator = draw(st.sampled_from(["reset", "filter"]))
    beacons = []
    for k, (x, y) in enumerate(draw(st.lists(POINT, max_size=8))):
        kind = draw(KINDS)
        if estimator == "filter" or not kind.needs_filter:
            beacons.append(Beacon(kind, x, y, id=str(k), facing_deg=draw(st.floats(-180, 180))))
    floors = draw(st.lists(st.tuples(POINT, st.floats(1, 8)), max_size=2))
    zones = [Zone([(x, y), (x + w, y), (x + w, y + 3.3), (x, y + 3.3)], draw(rates())) for (x, y), w in floors]
    world = World.from_polygons(WALLS, bounds=(-1, -1, 29, 24), robot_radius=0.2, zones=zones)
    path = np.array(draw(st.lists(POINT, min_size=2, max_size=7)))
    start = draw(
        st.sampled_from(
            [
                None,
                Fix.full(0.0, position_std_m=0.2, heading_std=0.05),
                Fix(s_m=0.0, position_cov=[[0.1, 0.03], [0.03, 0.05]]),
            ]
        )
    )
    return world, path, draw(rates()), tuple(beacons), estimator, start


SHARES = [0.0, 0.123456, 0.5, 0.77, 1.0]


def ask(javascript, scene, worst=False):
    world, path, noise, beacons, estimator, start = scene
    page = scene_of(world, [path], noise, beacons=beacons, estimator=estimator, start_fix=start)
    return javascript("scene", scene=page, at=SHARES, worst=worst)[0]


def expected_of(scene):
    world, path, noise, beacons, estimator, start = scene
    return drift_with_beacons(path, noise, beacons, world, fixes=[start] if start else [], estimator=estimator)


def test_a_tag_is_seen_from_where_it_is_and_not_through_a_wall(javascript):
    """Single points of a path: where it arrives at a tag, and where it touches the range of one from the side."""
    seen = BeaconKind.landmark(range_m=5.0, position_std_m=0.1, heading_std=0.02, view_angle_deg=120)
    beside = BeaconKind.landmark(range_m=4.0, position_std_m=0.1, heading_std=0.02)
    beacons = (
        Beacon(seen, 5.0, 1.0, id="at", facing_deg=0.0),
        Beacon(beside, 2.0, 5.0, id="beside"),
        Beacon(beside, 10.0, 5.0, id="behind a wall"),
    )
    walls = [[(8, 2), (12, 2), (12, 3), (8, 3)], [(5.2, 1.1), (5.6, 1.1), (5.6, 1.3), (5.2, 1.3)]]
    world = World.from_polygons(walls, bounds=(-1, -1, 29, 24), robot_radius=0.2)
    for path in ([[0.0, 1.0], [5.0, 1.0]], [[0.0, 1.0], [2.0, 1.0], [2.0, 1.0], [14.0, 1.0]]):
        scene = (world, np.array(path), OdometryNoise(heading_var_per_m=1e-3), beacons, "reset", None)
        readings = readings_on(scene[1], BeaconColumns.of(beacons), world)
        expected = [readings.s_m[readings.source == k].tolist() for k in range(3)]
        assert expected[0]
        assert (expected[1], expected[2]) == ([2.0], [])
        assert ask(javascript, scene)["readings"] == expected


@pytest.mark.slow
@given(scene=scenes())
@settings(max_examples=80)
def test_drift_with_beacons_on_random_scenes(javascript, scene):
    world, path, _, beacons, *_ = scene
    found, drift = ask(javascript, scene), expected_of(scene)
    readings = readings_on(path, BeaconColumns.of(beacons), world)
    for k, of_beacon in enumerate(found["readings"]):
        assert of_beacon == pytest.approx(readings.s_m[readings.source == k].tolist(), abs=2e-6)
    scale = max(float(np.max(drift.rms)) ** 2, 1e-12)
    for share, one in zip(SHARES, found["at"], strict=True):
        there = drift.at(min(share * float(drift.length), float(drift.length))).moments
        got = [one["N"], *one["e1"], *one["e2"]]
        wanted = [there.N.real, there.e1.real, there.e1.imag, there.e2.real, there.e2.imag]
        size = np.array([scale, scale**0.5, scale**0.5, scale, scale])
        assert np.abs(np.array(got) - np.array(wanted, dtype=float)) / size == pytest.approx(0, abs=CLOSE)


@given(scene=scenes())
@settings(max_examples=40)
def test_greatest_drift_anywhere(javascript, scene):
    found, drift = ask(javascript, scene, worst=True), expected_of(scene)
    assert found["worst"] == pytest.approx(worst_rms(drift), rel=1e-8, abs=1e-9)


@pytest.mark.parametrize("estimator", ["reset", "filter"])
def test_systematic_errors_that_differ_between_drives(javascript, estimator):
    noise = OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=1e-3, heading_bias_per_m=1e-3)
    noise = replace(noise, heading_bias_std_per_m=2e-3, heading_bias_std_per_rad=0.02, distance_scale_std=0.01)
    path = np.array([[0.0, 0.0], [12.0, 1.0], [13.0, 14.0], [2.0, 13.0]])
    beacons = (Beacon(BeaconKind.rfid(range_m=2.0, position_std_m=0.1), 12.0, 2.0, id="a"),)
    scene = (None, path, noise, beacons, estimator, None)
    found, drift = ask(javascript, scene), expected_of(scene)
    there = drift.at(np.array(SHARES) * float(drift.length))
    assert [one["N"] for one in found["at"]] == pytest.approx(there.moments.N.real.tolist(), rel=CLOSE)


def test_a_range_under_reset_is_said_not_computed(javascript):
    beacons = (Beacon(BeaconKind.range_only(range_m=9.0, range_std_m=0.1), 3.0, 2.0, id="a"),)
    scene = (None, np.array([[0.0, 0.0], [9.0, 0.0]]), OdometryNoise(heading_var_per_m=1e-4), beacons, "reset", None)
    assert "needs the estimator" in ask(javascript, scene)["error"]
