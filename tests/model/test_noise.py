"""OdometryNoise: what its constructors mean, and what they refuse."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from driftplan import OdometryNoise, Run, predict_drift


def test_from_std_reproduces_what_was_measured():
    noise = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.1, after_m=20.0, heading_deg_per_full_turn=3.0)
    end = predict_drift([(0, 0), (20, 0)], noise).end
    assert np.degrees(end.heading_std) == pytest.approx(2.0, rel=1e-9)
    along = predict_drift([(0, 0), (20, 0)], OdometryNoise(distance_var_per_m=noise.distance_var_per_m)).end
    assert along.cov[0, 0] == pytest.approx(0.01, rel=1e-9)
    spin = predict_drift([Run(length_m=0.0, turn_rad=2 * np.pi)], noise).end
    assert np.degrees(spin.heading_std) == pytest.approx(3.0, rel=1e-9)


def test_per_step_gives_each_step_its_noise():
    noise = OdometryNoise.per_step(heading_std=0.01, distance_std=0.1, lateral_std=0.2, step_m=0.5)
    end = predict_drift([(0, 0), (5, 0)], noise).end
    assert end.heading_std == pytest.approx(0.01 * 10**0.5, rel=1e-9)
    still = OdometryNoise.per_step(heading_std=0.0, distance_std=0.1, lateral_std=0.2, step_m=0.5)
    np.testing.assert_allclose(predict_drift([(0, 0), (5, 0)], still).end.cov, np.diag([0.1, 0.4]), atol=1e-12)


def test_scaling_the_noise_scales_a_small_drift():
    noise = OdometryNoise(heading_var_per_m=1e-8, distance_var_per_m=1e-6, distance_scale_error=1e-4)
    path = [(0, 0), (20, 0), (20, 5)]
    small, large = predict_drift(path, noise).end.rms, predict_drift(path, noise.scaled(3.0)).end.rms
    assert large == pytest.approx(3 * float(small), rel=1e-4)  # first order in the noise


def test_amcl_alphas_become_rates_with_a_warning():
    with pytest.warns(UserWarning, match="filter tuning, not physics"):
        noise = OdometryNoise.from_amcl(0.2, 0.1, 0.3, 0.4, step_m=0.5, step_rad=0.25)
    # per update of 0.5 m: two rotations of variance alpha2 d², one distance of variance alpha3 d²
    assert noise.heading_var_per_m * 0.5 == pytest.approx(2 * 0.1 * 0.25)
    assert noise.distance_var_per_m * 0.5 == pytest.approx(0.3 * 0.25)
    assert noise.heading_var_per_rad * 0.25 == pytest.approx(0.2 * 0.0625)
    assert noise.distance_var_per_rad * 0.25 == pytest.approx(0.4 * 0.0625)


def test_it_is_a_value():
    one, two = OdometryNoise(heading_var_per_m=1e-4), OdometryNoise(heading_var_per_m=1e-4)
    assert one == two
    assert hash(one) == hash(two)
    with pytest.raises(FrozenInstanceError):
        one.heading_var_per_m = 2.0
    assert repr(one) == "OdometryNoise(heading_var_per_m=0.0001)"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"heading_var_per_m": -1e-9}, "heading_var_per_m >= 0, got -1e-09"),
        ({"heading_var_per_m": float("nan")}, "heading_var_per_m finite, got nan"),
        ({"distance_var_per_m": float("inf")}, "distance_var_per_m finite, got inf"),
        ({"distance_var_per_m": "a lot"}, "distance_var_per_m to be a number, got 'a lot'"),
        ({"heading_var_per_step": 0.1}, "heading_var_per_step=0.1 needs step_m"),
        ({"heading_law": "laplace"}, "needs step_m"),
        ({"heading_law": "cauchy"}, "heading_law one of"),
        (
            {"heading_law": "von_mises", "step_m": 1.0, "heading_distance_corr": 0.5},
            "not defined for heading_law='von_mises'",
        ),
        ({"step_m": 0.0}, "step_m > 0, got 0.0"),
        ({"heading_distance_corr": 1.5}, r"heading_distance_corr in \[-1, 1\], got 1.5"),
        ({"distance_scale_error": -1.0}, "distance_scale_error > -1"),
    ],
)
def test_bad_rates_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        OdometryNoise(**arguments)


def test_unknown_keywords_are_refused():
    with pytest.raises(TypeError, match="heading_var"):
        OdometryNoise(heading_var=1e-4)
    with pytest.raises(ValueError, match="after_m > 0, got 0"):
        OdometryNoise.from_std(heading_deg=1.0, distance_m=0.1, after_m=0.0)
    with pytest.raises(ValueError, match="heading_deg >= 0"):
        OdometryNoise.from_std(heading_deg=-1.0, distance_m=0.1, after_m=1.0)
    with pytest.raises(ValueError, match="std_factor >= 0"):
        OdometryNoise().scaled(-1.0)
