"""The demo's tags: its rounds are drivable, its layout is the fewest, and what cannot be done is said."""

import numpy as np
import pytest

from driftplan.model.noise import OdometryNoise
from driftplan.report.commands.demo import LIMIT_M, RADIUS_M, ROUNDS, as_json, demo_layout, sentence
from driftplan.world.mapfiles import bundled_map, load_world


@pytest.fixture(scope="module")
def world():
    return load_world(bundled_map("warehouse"), robot_radius=RADIUS_M)


def test_the_robot_can_drive_the_rounds(world):
    for waypoints in ROUNDS:
        path = np.array(waypoints, dtype=float)
        assert world.segments_free(path[:-1], path[1:]).all()


def test_the_layout_is_proven_and_holds_the_limit_and_is_always_the_same(world):
    noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    layout, again = demo_layout(world, noise), demo_layout(world, noise)
    assert layout.proven
    assert layout.worst_drift <= LIMIT_M
    assert layout.beacons == again.beacons
    assert sentence(layout).startswith(f"{len(layout.beacons)} RFID tags keep the drift of 5 rounds under 0.8 m")
    assert as_json(layout)["lower_bound"] == len(layout.beacons)


@pytest.mark.parametrize(
    ("noise", "said"),
    [
        (OdometryNoise(heading_var_per_m=0.1), "no tags keep the drift of all rounds under 0.8 m with this odometry: "),
        (OdometryNoise.per_step(heading_std=0.01, distance_std=0.01, step_m=1.0), "noise per metre, not per step"),
    ],
)
def test_odometry_that_is_too_bad_or_of_another_model_does_not_end_the_demo(world, noise, said):
    assert said in demo_layout(world, noise)
