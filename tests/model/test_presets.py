"""Presets: each says where it is from, and means what its source states."""

from __future__ import annotations

import numpy as np
import pytest

from driftplan.model.drift import predict_drift
from driftplan.model.literature import StepNoise, dead_reckoning
from driftplan.model.presets import PRESETS


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_names_robot_source_and_caution(name):
    preset = PRESETS[name]
    assert preset.robot
    assert preset.source
    assert preset.caution
    assert predict_drift([(0, 0), (1, 0)], preset.noise).end.rms > 0


@pytest.mark.parametrize(
    ("name", "mean"), [("visual_odometry_indoor", 0.0), ("visual_odometry_indoor_with_drift", 6.8e-5)]
)
def test_the_camera_presets_have_the_moments_of_the_stated_laws(name, mean):
    """Against the paper's own parametrisation, which shares only the algebra."""
    steps, d = 500, 0.064
    stated = StepNoise.polar(
        translation_m=(d, 0.0),
        heading_std_rad=3.6e-3 * 2**0.5,
        heading_mean_rad=mean,
        direction_std_rad=0.0307**0.5,
        distance_std_m=8.5467e-5**0.5,
    )
    there = dead_reckoning(np.zeros(steps), np.tile([d, 0.0], (steps, 1)), stated)
    here = predict_drift([(0, 0), (steps * d, 0)], PRESETS[name].noise).end
    np.testing.assert_allclose(here.bias, there.bias[-1], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(here.cov, there.cov[-1], rtol=1e-9, atol=1e-12)


def test_presets_cannot_be_changed():
    with pytest.raises(TypeError):
        PRESETS["mine"] = PRESETS["textbook_steps"]
