"""The exact drift of OMPL paths: against predict_drift where that reads them too, and against drives simulated here."""

from __future__ import annotations

from itertools import pairwise
from math import pi

import numpy as np
import pytest
from ompl import base as ob
from ompl import control as oc
from ompl import geometric as og

from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Runs
from driftplan.model.spatial.drift import predict_flight_drift
from driftplan.planning.cost import CostRates, bracket
from driftplan.planning.ompl.objective import DriftObjective
from driftplan.planning.ompl.paths import predict_ompl_path
from driftplan.planning.roadmap.prices import exact_drift
from driftplan.world.world import World
from driftplan.world.zones import Zone

NOISE = OdometryNoise(heading_var_per_m=4e-3, distance_var_per_m=1e-3, heading_var_per_rad=6e-3)
WET = Zone([(-2, -9), (2, -9), (2, 9), (-2, 9)], OdometryNoise(heading_var_per_m=3e-2))
WORLD = World.from_polygons([], bounds=(-10, -10, 10, 10), robot_radius=0.2, zones=[WET])


def path_of(space, poses):
    si = ob.SpaceInformation(space)
    path = og.PathGeometric(si)
    state = si.allocState()
    for pose in poses:
        if isinstance(space, ob.RealVectorStateSpace):
            for k, value in enumerate(pose):
                state[k] = float(value)
        elif isinstance(space, ob.SE3StateSpace):
            state.setXYZ(*map(float, pose[:3]))
            state.rotation().setAxisAngle(0.0, 0.0, 1.0, float(pose[3]))
        else:
            state.setXY(float(pose[0]), float(pose[1]))
            state.setYaw(float(pose[2]))
        path.append(state)
    return si, path


POSES = [(-6.0, -3.0, 0.4), (-1.0, 2.0, 2.0), (-1.5, -2.0, -2.5), (5.0, 3.0, 1.0)]


def test_a_path_in_the_plane_drifts_as_its_waypoints_say():
    xy = np.array(POSES)[:, :2]
    si, path = path_of(ob.RealVectorStateSpace(2), xy)
    one = predict_ompl_path(path, si, NOISE)
    other = predict_drift(xy, NOISE)
    np.testing.assert_allclose(one.rms, other.rms, rtol=1e-12)
    np.testing.assert_allclose(one.cov, other.cov, rtol=1e-12, atol=1e-15)
    across = predict_ompl_path(path, si, NOISE, WORLD)
    assert float(across.end.rms) == pytest.approx(float(exact_drift(WORLD, xy, NOISE).end.rms), rel=1e-9)
    assert across.end.rms > one.end.rms


def test_without_noise_of_turning_the_heading_on_the_way_does_not_matter():
    noise = OdometryNoise(heading_var_per_m=4e-3, distance_var_per_m=1e-3, lateral_var_per_m=2e-4)
    si, path = path_of(ob.SE2StateSpace(), POSES)
    expected = predict_drift(np.array(POSES)[:, :2], noise)
    np.testing.assert_allclose(predict_ompl_path(path, si, noise).cov, expected.cov, rtol=1e-12, atol=1e-15)


def test_a_flight_drifts_as_its_waypoints_say():
    xyz = np.array([(0, 0, 0), (5, 1, 2), (4, -3, 3), (9, 0, 0)], float)
    rates = {"rotation_var_per_m": 1e-3, "distance_var_per_m": 2e-3, "lateral_var_per_m": 5e-4}
    noise = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=2e-3, lateral_var_per_m=5e-4)
    expected = predict_flight_drift(xyz, **rates)
    for space, poses in ((ob.RealVectorStateSpace(3), xyz), (ob.SE3StateSpace(), np.c_[xyz, [0, 1, 2, 1]])):
        si, path = path_of(space, poses)
        np.testing.assert_allclose(predict_ompl_path(path, si, noise).cov, expected.cov, rtol=1e-12)


def drive(si, path, noise, rng, runs=4000, steps=120):
    """Final errors of odometry that errs as ``noise`` says while OMPL's own interpolation is driven, step by step.

    Each motion is cut into ``steps`` steps. The odometry reports every step's displacement in the body's frame at the
    step's middle, and its change of heading; half of a step's heading error acts before and half after it moves.
    """
    space = si.getStateSpace()
    states = path.getStates()
    between = si.allocState()
    theta, e = np.zeros(runs), np.zeros(runs, complex)
    for a, b in pairwise(states):
        x, y, yaw = a.getX(), a.getY(), a.getYaw()
        step_m = space.getPath(a, b).length() * RADIUS / steps if hasattr(space, "getPath") else None
        for k in range(1, steps + 1):
            space.interpolate(a, b, k / steps, between)
            dx, dy = between.getX() - x, between.getY() - y
            turn = abs((between.getYaw() - yaw + pi) % (2 * pi) - pi)
            length = np.hypot(dx, dy) if step_m is None else step_m
            half = 0.5 * (noise.heading_var_per_m * length + noise.heading_var_per_rad * turn)
            theta += rng.normal(0, half**0.5, runs)
            along = rng.normal(0, (noise.distance_var_per_m * length + noise.distance_var_per_rad * turn) ** 0.5, runs)
            u = (dx + 1j * dy) / max(np.hypot(dx, dy), 1e-300)
            e += np.exp(1j * theta) * (dx + 1j * dy + along * u) - (dx + 1j * dy)
            theta += rng.normal(0, half**0.5, runs)
            x, y, yaw = between.getX(), between.getY(), between.getYaw()
    return e


RADIUS = 1.3


@pytest.mark.parametrize(
    "make",
    [ob.SE2StateSpace, lambda: ob.DubinsStateSpace(RADIUS), lambda: ob.ReedsSheppStateSpace(RADIUS)],
    ids=["se2", "dubins", "reeds_shepp"],
)
def test_the_drift_is_that_of_simulated_drives(make):
    noise = OdometryNoise(
        heading_var_per_m=4e-3, distance_var_per_m=1e-3, heading_var_per_rad=6e-3, distance_var_per_rad=5e-4
    )
    si, path = path_of(make(), POSES)
    e = drive(si, path, noise, np.random.default_rng(0))
    drift = predict_ompl_path(path, si, noise)
    assert len(e) == 4000
    square = np.abs(e) ** 2
    assert abs(square.mean() - float(drift.end.rms) ** 2) < 4 * square.std() / len(e) ** 0.5
    bias = complex(*drift.end.bias)
    assert abs((e - bias).real.mean()) < 4 * e.real.std() / len(e) ** 0.5
    assert abs((e - bias).imag.mean()) < 4 * e.imag.std() / len(e) ** 0.5
    where = np.array(drift.xy[-1])
    np.testing.assert_allclose(where, POSES[-1][:2], atol=1e-5)


@pytest.mark.parametrize("name", ["plane", "se2", "dubins", "reeds_shepp", "space", "se3"])
def test_the_exact_error_lies_in_the_bracket_of_the_additive_cost(name):
    spaces = {
        "plane": lambda: ob.RealVectorStateSpace(2),
        "se2": ob.SE2StateSpace,
        "dubins": lambda: ob.DubinsStateSpace(RADIUS),
        "reeds_shepp": lambda: ob.ReedsSheppStateSpace(RADIUS),
        "space": lambda: ob.RealVectorStateSpace(3),
        "se3": ob.SE3StateSpace,
    }
    turns = name not in ("plane", "space")  # in R^2 and R^3 turns lie between motions, where OMPL prices nothing
    noise = OdometryNoise(
        heading_var_per_m=2e-2,
        distance_var_per_m=1e-3,
        heading_var_per_rad=1e-2 * turns,
        distance_var_per_rad=1e-3 * turns,
    )
    size = {"plane": 2, "space": 3, "se3": 4}.get(name, 3)
    rng = np.random.default_rng(1)
    for _ in range(20):
        poses = rng.normal(0, 4, (5, size))
        si, path = path_of(spaces[name](), poses)
        goal = poses[-1][: 3 if name in ("space", "se3") else 2]
        cost = path.cost(DriftObjective(si, noise, goal)).value()
        drift = predict_ompl_path(path, si, noise)
        exact = float(drift.end.rms) ** 2
        assert exact <= cost * (1 + 1e-9)
        # Λ at the heading error of the end; with the position part left in, the quotient is only nearer to one.
        if name in ("space", "se3"):
            turned = sum(abs(np.diff(poses[:, 3]))) if name == "se3" else 0.0
            length = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1).sum()
            rates = CostRates.of(noise, 3)
            std = (rates.heading * length + rates.turn_heading * turned) ** 0.5
        else:
            std = float(drift.end.heading_std)
        assert exact >= bracket(std) * cost * (1 - 1e-9)


def test_driving_a_curve_backwards_drifts_as_driving_its_mirror_forwards():
    """Seen from behind, a car in reverse is a car that drives forwards."""
    si, there = path_of(ob.ReedsSheppStateSpace(RADIUS), [(0, 0, 0), (-5, 2, -0.7)])
    _, mirror = path_of(ob.ReedsSheppStateSpace(RADIUS), [(0, 0, pi), (-5, 2, -0.7 + pi)])
    one, other = (predict_ompl_path(path, si, NOISE) for path in (there, mirror))
    assert float(one.length) == pytest.approx(float(other.length), abs=1e-6)
    np.testing.assert_allclose(one.end.cov, other.end.cov, rtol=1e-5)


def test_zones_under_curves_count():
    si, path = path_of(ob.DubinsStateSpace(RADIUS), POSES)
    inside = World.from_polygons([], bounds=WORLD.bounds, robot_radius=0.2, zones=[Zone(
        [(-50, -50), (50, -50), (50, 50), (-50, 50)], WET.noise)])  # fmt: skip
    dry, mixed, wet = (float(predict_ompl_path(path, si, NOISE, world).end.rms) for world in (None, WORLD, inside))
    assert dry < mixed < wet
    assert wet == pytest.approx(float(predict_ompl_path(path, si, WET.noise).end.rms), rel=1e-9)


def test_turning_on_the_spot_costs_in_se2():
    noise = OdometryNoise(heading_var_per_m=1e-3, heading_var_per_rad=1e-2)
    si, still = path_of(ob.SE2StateSpace(), [(0, 0, 0), (5, 0, 0), (10, 0, 0)])
    _, spun = path_of(ob.SE2StateSpace(), [(0, 0, 0), (5, 0, 0), (5, 0, 2.0), (10, 0, 2.0)])
    one, other = (float(predict_ompl_path(path, si, noise).end.rms) ** 2 for path in (still, spun))
    # Heading variance 0.02 at a lever of 5 m: E|(r - 1) 5|² = 50 (1 - exp(-0.01)), and less of what came before.
    assert other - one == pytest.approx(50 * (1 - np.exp(-0.01)), rel=0.02)


def test_bad_input_is_refused():
    si, path = path_of(ob.RealVectorStateSpace(2), [(0, 0)])
    with pytest.raises(ValueError, match="at least 2 states, got 1"):
        predict_ompl_path(path, si, NOISE)
    si, path = path_of(ob.RealVectorStateSpace(3), [(0, 0, 0), (1, 1, 1)])
    with pytest.raises(ValueError, match="no noise per radian"):
        predict_ompl_path(path, si, NOISE)
    with pytest.raises(ValueError, match="no world in a space of three"):
        predict_ompl_path(path, si, NOISE, WORLD)
    with pytest.raises(ValueError, match="white noise in three dimensions"):
        predict_ompl_path(path, si, OdometryNoise(heading_var_per_m=1e-3, heading_bias_per_m=1e-3))
    si, path = path_of(ob.SE3StateSpace(), [(0, 0, 0, 0), (0, 0, 0, 1)])
    with pytest.raises(ValueError, match="turns on the way only"):
        predict_ompl_path(path, si, NOISE)


def test_a_path_of_controls_drifts_as_what_its_controls_drive():
    """Not along the chords between its states: here half a circle, of which the states are the ends."""
    space = ob.SE2StateSpace()
    bounds = ob.RealVectorBounds(2)
    bounds.setLow(-9)
    bounds.setHigh(9)
    space.setBounds(bounds)
    controls = oc.RealVectorControlSpace(space, 2)
    controls.setBounds(bounds)
    si = oc.SpaceInformation(space, controls)

    def drive(state, control, seconds, result):
        x, y, yaw, speed, rate = state.getX(), state.getY(), state.getYaw(), control[0], control[1]
        middle = yaw + 0.5 * rate * seconds
        result.setXY(x + speed * seconds * np.cos(middle), y + speed * seconds * np.sin(middle))
        result.setYaw(yaw + rate * seconds)

    si.setStatePropagator(drive)
    si.setStateValidityChecker(ob.AllValidStateValidityChecker(si))
    si.setPropagationStepSize(0.01)
    si.setup()
    path, start, end, control = oc.PathControl(si), si.allocState(), si.allocState(), si.allocControl()
    start.setXY(0.0, 0.0), start.setYaw(0.0), end.setXY(0.0, 2.0), end.setYaw(np.pi)
    control[0], control[1] = 1.0, 1.0
    path.append(start, control, 3.14)
    path.append(end)
    noise = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-4)
    found = predict_ompl_path(path, si, noise)
    arc = Runs(np.asarray(0j), np.asarray(0.0), np.zeros(1), np.array([np.pi]), np.ones(1))
    assert float(found.length) == pytest.approx(np.pi, rel=2e-3)
    assert float(found.end.rms) == pytest.approx(float(predict_drift(arc, noise).end.rms), rel=5e-3)
