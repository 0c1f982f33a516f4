"""Noise files: what is written is read back to the last bit, and nothing but a noise is read."""

from __future__ import annotations

from dataclasses import fields

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.errors import TrajectoryError
from driftplan.model.calibration.fit import fit_noise
from driftplan.model.calibration.recordings import simulate_log
from driftplan.model.noise import OdometryNoise
from driftplan.world.noise_files import load_noise, save_noise

RATES = [f.name for f in fields(OdometryNoise) if f.name.endswith(("_per_m", "_per_rad")) and "var" in f.name]


@given(rates=st.dictionaries(st.sampled_from(RATES), st.floats(0, 1e13)), scale=st.floats(-0.5, 2))
@settings(deadline=None, max_examples=50)
def test_a_noise_is_read_back_to_the_last_bit(rates, scale, tmp_path_factory):
    noise = OdometryNoise(**rates, distance_scale_error=scale)
    file = tmp_path_factory.mktemp("noise") / "noise.yaml"
    save_noise(file, noise)
    assert load_noise(file) == noise


@pytest.mark.parametrize(
    "noise",
    [
        OdometryNoise(),
        OdometryNoise.per_step(heading_std=0.1, distance_std=0.2, step_m=1.0, heading_law="laplace"),
        OdometryNoise(heading_var_per_m=1e-5, distance_var_per_m=1e-5, heading_distance_corr=-0.3),
    ],
)
def test_every_kind_of_noise_can_be_kept(noise, tmp_path):
    save_noise(tmp_path / "noise.yaml", noise)
    assert load_noise(tmp_path / "noise.yaml") == noise


def test_a_fit_is_kept_with_its_intervals(tmp_path):
    log, truth = simulate_log([(0, 0), (200, 0)], OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3))
    fit = fit_noise(log, truth, resamples=100)
    save_noise(tmp_path / "noise.yaml", fit)
    assert load_noise(tmp_path / "noise.yaml") == fit.noise
    text = (tmp_path / "noise.yaml").read_text()
    low, high = fit.intervals["heading_var_per_m"]
    assert f"[{low:.3g}, {high:.3g}]" in text
    assert "95 % intervals" in text
    assert "hardly turned" in text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "heading_var_per_m: 1.0e-4\nwheel_radius: 0.1\n",
            "unknown key 'wheel_radius'; expected keys of heading_var_per_m",
        ),
        ("heading_var_per_m: -1.0\n", "expected heading_var_per_m >= 0, got -1.0"),
        ("heading_var_per_m: much\n", "expected heading_var_per_m"),
        ("heading_var_per_m: .nan\n", "expected heading_var_per_m finite"),
        ("- 1\n- 2\n", "expected keys of OdometryNoise"),
        ("", "expected keys of OdometryNoise"),
        ("a: [1, 2\n", "not plain YAML"),
        ("a: !!python/object/apply:os.system ['true']\n", "not plain YAML"),
        ("\x00", "not plain YAML"),
        ("[" * 2000, "not plain YAML"),
        ("# " + "x" * (1 << 20), "at most 1048576 bytes"),
    ],
)
def test_what_is_no_noise_is_refused_by_name(text, message, tmp_path):
    file = tmp_path / "noise.yaml"
    file.write_text(text)
    with pytest.raises(TrajectoryError, match=message) as caught:
        load_noise(file)
    assert str(file) in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(TrajectoryError, match=r"nowhere\.yaml: cannot be read: No such file"):
        load_noise(tmp_path / "nowhere.yaml")


def test_a_file_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    with pytest.raises(OSError, match="No such file"):
        save_noise(tmp_path / "nowhere" / "noise.yaml", OdometryNoise())
    assert list(tmp_path.iterdir()) == []
