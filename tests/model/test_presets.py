"""Presets: each says where it is from, and means what its source states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from driftplan.literature import StepNoise, dead_reckoning
from driftplan.model.calibration.fit import PARAMETERS, fit_noise
from driftplan.model.drift import predict_drift
from driftplan.model.presets import PRESETS
from driftplan.world.odometry_logs import read_odometry, read_truth


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


def test_fitted_presets_lie_within_their_intervals():
    fitted = [preset for preset in PRESETS.values() if preset.intervals]
    assert len(fitted) == 3
    for preset in fitted:
        assert set(preset.intervals) == set(PARAMETERS)
        for name, (low, high) in preset.intervals.items():
            assert low <= getattr(preset.noise, name) <= high, name
        shortest, longest = preset.lengths_m
        assert 0 < shortest < longest


DATA = Path(__file__).resolve().parents[2] / "../shared/data"


def recorded_drives(name):
    """The recordings that a preset was fitted to: estimates and truths."""
    if name == "mower_wheels_and_gyro":
        file = DATA / "plaza1/Plaza1_.mat"
        return read_odometry(file, kind="increments", variable="DR"), read_truth(file, variable="GT")
    if name == "visual_inertial_drone":
        folder = DATA / "euroc_v1_02"
        estimates = [read_odometry(folder / f"stamped_traj_estimate{k}.txt.gz") for k in range(6)]
        return estimates, 6 * [read_truth(folder / "stamped_groundtruth.txt.gz")]
    files = [DATA / f"mrclam7/Robot{k}" for k in (1, 2, 3)]
    return (
        [read_odometry(f"{file}_Odometry.dat.gz") for file in files],
        [read_truth(f"{file}_Groundtruth.dat.gz") for file in files],
    )


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="the recorded drives are not here")
@pytest.mark.parametrize("name", [name for name, preset in PRESETS.items() if preset.intervals])
def test_fitted_presets_are_what_the_recordings_say(name):
    preset = PRESETS[name]
    fit = fit_noise(*recorded_drives(name))
    assert (fit.check.lengths[0].length_m, fit.check.lengths[-1].length_m) == pytest.approx(preset.lengths_m, rel=0.02)
    for parameter, (low, high) in preset.intervals.items():
        # stated to two digits; two of a hundred of what is unsure
        width = high - low
        assert getattr(preset.noise, parameter) == pytest.approx(
            getattr(fit.noise, parameter), rel=0.03, abs=0.02 * width
        )
        assert (low, high) == pytest.approx(fit.intervals[parameter], rel=0.05, abs=0.05 * width)


def test_presets_cannot_be_changed():
    with pytest.raises(TypeError):
        PRESETS["mine"] = PRESETS["textbook_steps"]
