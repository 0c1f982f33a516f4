"""What a fusing robot's Gaussian error is in moments, and which ranges and bearings its linear filter misuses."""

from __future__ import annotations

import numpy as np
import pytest

from driftplan.model.filter_state import FilterState
from driftplan.model.fusion import _as_moments, _of_moments, belief_at_start, fuse, misused_from
from driftplan.model.moments import Moments, identity
from driftplan.model.noise import NO_SPREAD, OdometryNoise, SystematicSpread
from driftplan.model.paths import read_path
from driftplan.model.point_drift import PointDrift
from driftplan.model.readings import Fix, Readings


def gaussian(seed: int, size: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of (e_x, e_y, θ), with headings that may be wrong by much."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(size, size)) * np.array([0.5, 0.3, 0.4, 0.1, 0.2])[:size, None]
    return rng.normal(size=size) * 0.5, root @ root.T


def averaged(mean: np.ndarray, P: np.ndarray) -> dict[str, complex]:
    """Moments of the error by quadrature over its three numbers."""
    x, weight = np.polynomial.hermite_e.hermegauss(24)
    points = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3)
    w = np.prod(np.stack(np.meshgrid(weight, weight, weight), axis=-1).reshape(-1, 3), axis=1) / (2 * np.pi) ** 1.5
    ex, ey, theta = (mean[:3] + points @ np.linalg.cholesky(P[:3, :3]).T).T
    e, d = ex + 1j * ey, np.exp(1j * theta) - 1
    values = {"d1": d, "d2": d * d, "D": abs(d) ** 2, "e1": e, "N": abs(e) ** 2, "e2": e * e}
    return {name: np.sum(w * value) for name, value in (values | {"a": e * np.conj(d), "b": e * d}).items()}


@pytest.mark.parametrize("size", [3, 5])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_gaussian_error_has_the_moments_of_its_average_and_comes_back_from_them(seed, size):
    mean, P = gaussian(seed, size)
    u, p = np.exp(0.3j), 2.0 + 1.0j
    moments = _as_moments(u, p, FilterState.from_matrix(P, mean))
    for name, value in averaged(mean, P).items():
        assert complex(getattr(moments, name)) == pytest.approx(complex(value), rel=1e-10), name
    assert (moments.u, moments.p) == (u, p)
    names = ("heading_bias_per_m", "distance_scale_error")[: size - 3]
    spread = SystematicSpread(**dict(zip(names, (0.1, 0.2), strict=False)))
    back = _of_moments(moments, spread)
    np.testing.assert_allclose(back.matrix[:3, :3], P[:3, :3], rtol=1e-10)
    np.testing.assert_allclose(back.matrix[3:, 3:], np.diag([0.1**2, 0.2**2][: size - 3]), rtol=1e-12)
    np.testing.assert_allclose(back.mean, [*mean[:3], 0.0, 0.0][:size], rtol=1e-10, atol=1e-14)
    unbiased = _as_moments(u, p, FilterState.from_matrix(P))
    for name, value in averaged(0 * mean, P).items():
        assert complex(getattr(unbiased, name)) == pytest.approx(complex(value), rel=1e-10, abs=1e-15), name
    assert _of_moments(unbiased, NO_SPREAD).mean is None


def test_without_readings_a_robot_drives_on_whatever_borders_are_named():
    runs, noise = read_path([(0, 0), (3, 1), (5, 0)]), OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-2)
    which, position = np.zeros(2, dtype=int), Readings.of([Fix.position(2.0, position_std_m=0.01)])
    ends = [
        float(fuse(runs, which, (noise,), NO_SPREAD, identity(), *given)[0].leaving.N[1])
        for given in ((), (None, np.array([1])), (position, None), (position, np.array([1])))
    ]
    assert ends[0] == ends[1] == ends[2] > 0.02
    assert ends[3] < 2.1e-4


def test_what_is_known_at_the_start_is_what_a_fix_says():
    cov = np.array([[0.04, 0.01], [0.01, 0.09]])
    state = belief_at_start(Fix(s_m=0.0, position_cov=cov, heading_std=0.2))
    np.testing.assert_allclose(state.matrix[:2, :2], cov, rtol=1e-12)
    np.testing.assert_allclose(state.matrix[2], [0.0, 0.0, 0.04], rtol=1e-12)
    assert (belief_at_start(None).matrix == 0).all()


def beside(anchor: complex, along_std: float, across_std: float) -> PointDrift:
    """A robot at 1 + 2j whose error has these deviations towards the anchor and across."""
    towards = (anchor - (1 + 2j)) / abs(anchor - (1 + 2j))
    N, e2 = along_std**2 + across_std**2, (along_std**2 - across_std**2) * towards**2
    zero = np.zeros(1)
    return PointDrift(zero, Moments(zero + 1, zero + 1 + 2j, zero, zero, zero, zero, zero + N, zero + e2, zero, zero))


def test_a_range_is_misused_where_its_swing_is_a_share_of_its_deviation():
    """5 m away, 0.4 m along and 0.5 m across make a range wrong by 0.4·0.5/5 = 0.04 m to second order: 15 % of 0.267 m;
    and a bearing by 0.04/5 = 0.008 rad, 15 % of 0.0533 rad. Without an error across, neither."""
    anchor = 4 + 6j
    place = {"anchor": (4.0, 6.0)}
    for across, share in ((0.5, 1.0), (0.25, 0.5)):
        for std in (0.26, 0.27):
            fix = Fix.range(7.0, range_std_m=std * share, **place)
            expected = 7.0 if std < 0.04 / 0.15 else np.inf
            assert misused_from(Readings.of([fix]), beside(anchor, 0.4, across)) == expected
        for std in (0.053, 0.054):
            fix = Fix.bearing(7.0, bearing_std=std * share, **place)
            expected = 7.0 if std < 0.008 / 0.15 else np.inf
            assert misused_from(Readings.of([fix]), beside(anchor, 0.4, across)) == expected
    both = (
        Fix(s_m=7.0, range_std_m=0.26, bearing_std=1.0, **place),
        Fix(s_m=7.0, range_std_m=1.0, bearing_std=0.05, **place),
    )
    assert [misused_from(Readings.of([fix]), beside(anchor, 0.4, 0.5)) for fix in both] == [7.0, 7.0]


def test_the_first_reading_that_is_misused_counts_and_perfect_ones_are_as_good_as_a_micrometre():
    fixes = [Fix.range(s, anchor=(4.0, 6.0), range_std_m=std) for s, std in ((3.0, 1.0), (9.0, 0.1), (5.0, 0.2))]
    one = beside(4 + 6j, 0.4, 0.5)
    three = PointDrift(np.zeros(3), Moments(*(np.repeat(x, 3) for x in one.moments.arrays())))
    assert misused_from(Readings.of(fixes), three) == 5.0
    for along, expected in ((1e-6, np.inf), (2e-6, 3.0)):  # times 0.5 m over 5 m: 1e-7 and 2e-7 of 1e-6 m
        fix = Fix.range(3.0, anchor=(4.0, 6.0), range_std_m=0.0)
        assert misused_from(Readings.of([fix]), beside(4 + 6j, along, 0.5)) == expected
        fix = Fix.bearing(3.0, anchor=(4.0, 6.0), bearing_std=0.0)
        assert misused_from(Readings.of([fix]), beside(4 + 6j, 5 * along, 0.5)) == expected


def test_a_range_from_the_anchor_itself_is_left_out_and_so_not_misused():
    fix = Fix.range(3.0, anchor=(1.0, 2.0), range_std_m=0.5)
    zero = np.zeros(1)
    at_it = PointDrift(zero, Moments(zero + 1, zero + 1 + 2j, zero, zero, zero, zero, zero + 0.02, zero, zero, zero))
    assert misused_from(Readings.of([fix]), at_it) == np.inf
