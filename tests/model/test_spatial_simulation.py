"""The spatial oracle itself; that it agrees with the closed form is tested in test_spatial."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

import driftplan.model.spatial.simulation
from driftplan.model.spatial.rotations import RotationNoise
from driftplan.model.spatial.simulation import simulate_drift_3d

GOOD = {"rotations": [np.eye(3)] * 3, "translations": np.ones((3, 3)), "rotation_noise": RotationNoise.isotropic(0.1)}


MOTION = (RotationNoise.isotropic(0.6).sample(np.random.default_rng(1), 5), np.ones((5, 3)))


def test_same_seed_same_errors():
    one, two = (
        simulate_drift_3d(*MOTION, RotationNoise.isotropic(0.1), 0.01 * np.eye(3), runs=7, rng=seed)
        for seed in (3, np.random.default_rng(3))
    )
    np.testing.assert_array_equal(one, two)
    assert one.shape == (7, 6, 3)
    assert not one[:, 0].any()


def test_the_oracle_knows_no_moments():
    names = [
        f"{node.module}.{alias.name}"
        for node in ast.walk(ast.parse(Path(driftplan.model.spatial.simulation.__file__).read_text()))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    ]
    assert not [name for name in names if "moments" in name or name.startswith("spatial.")]


@pytest.mark.parametrize("runs", [0, -5, 2.0, True])
def test_bad_runs(runs):
    with pytest.raises(ValueError, match="expected runs a whole number >= 1"):
        simulate_drift_3d(**GOOD, runs=runs)
