"""The additive cost: laws that a planner needs, then quadrature, published numbers and the exact model as oracles."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import quad

from driftplan.model.noise import OdometryNoise
from driftplan.planning.cost import CostRates, bracket, edge_cost, geodesic_cost, turn_cost
from driftplan.planning.ompl.motion_prices import _arc
from driftplan.planning.roadmap.prices import AdditiveCost
from driftplan.world.world import World

HEADING_ONLY = OdometryNoise(heading_var_per_m=1.0)
NOISE = OdometryNoise(
    heading_var_per_m=1e-3,
    distance_var_per_m=4e-3,
    lateral_var_per_m=1e-3,
    heading_var_per_rad=2e-3,
    distance_var_per_rad=1e-3,
)

coordinate = st.floats(-50, 50).map(lambda x: round(x, 6))


def points(dimensions):
    return arrays(float, dimensions, elements=coordinate)


@st.composite
def three_points(draw):
    dimensions = draw(st.sampled_from([2, 3]))
    return tuple(draw(points(dimensions)) for _ in range(3))


def runs_cost(path, goal, noise):
    """Of a polyline, turns left out."""
    path = np.asarray(path, dtype=float)
    return edge_cost(path[:-1], path[1:], goal, noise).sum()


def arc_cost(start, heading, length, curvature, goal, noise):
    wx, wy = np.subtract(goal, start).tolist()
    return _arc(CostRates.of(noise), wx, wy, np.cos(heading), np.sin(heading), length, curvature)


# Laws

# Costs are sums of products of coordinates up to 100 m: rounding is relative to the largest lever, not to the result.
ROUND_OFF = 1e-9


@given(three_points())
def test_an_edge_costs_the_same_in_both_directions(case):
    a, b, goal = case
    np.testing.assert_allclose(edge_cost(a, b, goal, NOISE), edge_cost(b, a, goal, NOISE), rtol=1e-12)


@given(three_points(), st.floats(0, 1))
def test_cutting_an_edge_changes_nothing(case, share):
    a, b, goal = case
    cut = a + share * (b - a)
    halves = edge_cost(a, cut, goal, NOISE) + edge_cost(cut, b, goal, NOISE)
    np.testing.assert_allclose(halves, edge_cost(a, b, goal, NOISE), rtol=1e-9, atol=ROUND_OFF)


@given(st.floats(0, 1), st.floats(-1.5, 1.5), st.floats(0, 9), points(2), points(2))
def test_cutting_an_arc_changes_nothing(share, curvature, length, start, goal):
    heading = 0.4
    z = _along_arc(start, heading, curvature, share * length)
    first = arc_cost(start, heading, share * length, curvature, goal, NOISE)
    rest = arc_cost(z, heading + curvature * share * length, (1 - share) * length, curvature, goal, NOISE)
    whole = arc_cost(start, heading, length, curvature, goal, NOISE)
    np.testing.assert_allclose(first + rest, whole, rtol=1e-9, atol=ROUND_OFF)


@given(three_points())
def test_the_geodesic_bound_is_never_above_the_straight_run(case):
    a, b, goal = case
    assert geodesic_cost(a, b, goal, NOISE) <= edge_cost(a, b, goal, NOISE) * (1 + 1e-12)


@given(three_points(), st.integers(0, 2**32 - 1))
def test_the_geodesic_bound_is_never_above_a_detour(case, seed):
    a, b, goal = case
    way = np.random.default_rng(seed).normal(size=(4, len(a))) * 20 + (a + b) / 2
    path = np.vstack([a, way, b])
    assert geodesic_cost(a, b, goal, NOISE) <= runs_cost(path, goal, NOISE) * (1 + 1e-12)


@given(three_points(), st.integers(0, 2**32 - 1))
def test_the_geodesic_bound_is_a_metric(case, seed):
    a, b, goal = case
    c = np.random.default_rng(seed).normal(size=len(a)) * 30
    ab, ba = geodesic_cost(a, b, goal, NOISE), geodesic_cost(b, a, goal, NOISE)
    np.testing.assert_allclose(ab, ba, rtol=1e-11, atol=1e-15)
    assert geodesic_cost(a, a, goal, NOISE) == 0
    assert (ab > 0) == bool((a != b).any())
    assert ab <= (geodesic_cost(a, c, goal, NOISE) + geodesic_cost(c, b, goal, NOISE)) * (1 + 1e-11)


@given(three_points())
def test_the_geodesic_bound_to_the_goal_is_attained_by_the_straight_run(case):
    a, _, goal = case
    np.testing.assert_allclose(
        geodesic_cost(a, goal, goal, NOISE), edge_cost(a, goal, goal, NOISE), rtol=1e-12, atol=1e-15
    )


@given(three_points(), st.floats(-3, 3), points(2))
def test_turning_and_moving_the_world_changes_no_cost(case, angle, shift):
    a, b, goal = (np.asarray(p)[:2] for p in case)
    c, s = np.cos(angle), np.sin(angle)
    moved = [p @ np.array([[c, s], [-s, c]]) + shift for p in (a, b, goal)]
    for price in (edge_cost, geodesic_cost):
        np.testing.assert_allclose(price(*moved, NOISE), price(a, b, goal, NOISE), rtol=1e-6, atol=1e-6)


def test_a_plane_in_space_prices_like_isotropic_noise_about_two_of_three_axes():
    a, b, goal = np.array([[0.0, 1.0], [5.0, 2.0], [9.0, -3.0]])
    up = [np.append(p, 0.7) for p in (a, b, goal)]
    np.testing.assert_allclose(edge_cost(*up, HEADING_ONLY), 2 * edge_cost(a, b, goal, HEADING_ONLY))


def test_batches_agree_with_single_calls():
    rng = np.random.default_rng(1)
    a, b, goal = rng.normal(size=(5, 1, 2)), rng.normal(size=(7, 2)), rng.normal(size=2)
    for price in (edge_cost, geodesic_cost):
        table = price(a, b, goal, NOISE)
        assert table.shape == (5, 7)
        np.testing.assert_allclose(table[3, 4], price(a[3, 0], b[4], goal, NOISE), rtol=1e-14)


def test_a_turn_costs_more_the_farther_it_is_from_the_goal():
    far, near = turn_cost([[0, 0], [9, 0]], 1.0, [10, 0], NOISE)
    assert far == pytest.approx(2e-3 * 100 + 1e-3)
    assert near == pytest.approx(2e-3 * 1 + 1e-3)


# Oracles


def _along_arc(start, heading, curvature, s):
    z = s * np.exp(1j * (heading + curvature * s / 2)) * np.sinc(curvature * s / (2 * np.pi))
    return np.asarray(start) + np.array([z.real, z.imag])


@pytest.mark.parametrize("seed", range(20))
def test_an_edge_cost_is_the_integral_of_the_squared_lever(seed):
    rng = np.random.default_rng(seed)
    a, b, goal = rng.normal(0, 10, (3, 2 + seed % 2))
    length = np.linalg.norm(b - a)
    squares = quad(lambda t: np.sum((goal - a - t * (b - a)) ** 2) * length, 0, 1, epsabs=0, epsrel=1e-12)[0]
    rates = CostRates.of(NOISE, len(a))
    assert edge_cost(a, b, goal, NOISE) == pytest.approx(rates.heading * squares + rates.position * length, rel=1e-11)


@pytest.mark.parametrize("curvature", [0.0, 1e-12, -1e-8, 1e-5, -3e-3, 0.1, -0.9, 2.0, 11.0])
def test_an_arc_cost_is_the_integral_of_the_squared_lever(curvature):
    start, heading, length, goal = np.array([1.0, -2.0]), 0.8, 5.0, np.array([4.0, 3.0])
    squares = quad(
        lambda s: np.sum((goal - _along_arc(start, heading, curvature, s)) ** 2),
        0,
        length,
        epsabs=0,
        epsrel=1e-12,
        limit=500,
    )[0]
    q_h = 1e-3 + 2e-3 * abs(curvature)
    q_p = 5e-3 + 1e-3 * abs(curvature)
    # 1e-11: quadrature's own error; the closed form loses no digits between straight and curled up.
    expected = pytest.approx(q_h * squares + q_p * length, rel=1e-11)
    assert arc_cost(start, heading, length, curvature, goal, NOISE) == expected


def test_reference_numbers_of_the_edge_integrals():
    # Start (1, 2), heading 0.3, length 6, goal (10, 4); 60-digit quadrature.
    start, goal = np.array([1.0, 2.0]), np.array([10.0, 4.0])
    end = start + 6 * np.array([np.cos(0.3), np.sin(0.3)])
    assert edge_cost(start, end, goal, HEADING_ONLY) == pytest.approx(251.193522644, abs=1e-9)
    assert arc_cost(start, 0.3, 6.0, 0.0, goal, HEADING_ONLY) == pytest.approx(251.193522644, abs=1e-9)
    assert arc_cost(start, 0.3, 6.0, 0.25, goal, HEADING_ONLY) == pytest.approx(313.114911046, abs=1e-9)


def test_reference_numbers_of_the_geodesic_distance():
    origin = [0.0, 0.0]
    other = [1.2 * np.cos(0.5), 1.2 * np.sin(0.5)]
    sixty = [2 * np.cos(np.pi / 3), 2 * np.sin(np.pi / 3)]
    assert geodesic_cost([1, 0], [0, 1], origin, HEADING_ONLY) == pytest.approx(2 / 3, rel=1e-14)
    assert geodesic_cost([1, 0], other, origin, HEADING_ONLY) == pytest.approx(0.644766644353376, rel=1e-14)
    assert geodesic_cost([2, 0], sixty, origin, HEADING_ONLY) == pytest.approx(16 / 3, rel=1e-14)


def test_the_geodesic_bound_is_the_length_of_the_curve_that_is_straight_in_w_cubed():
    w0, w1 = 1.0 + 0j, 1.3 * np.exp(0.9j)
    chord = w0**3 + np.linspace(0, 1, 4001) * (w1**3 - w0**3)
    w = np.abs(chord) ** (1 / 3) * np.exp(1j * np.unwrap(np.angle(chord)) / 3)
    path = np.c_[w.real, w.imag]
    # A polyline through points of the geodesic is longer than it by O(1/n²).
    bound = geodesic_cost(path[0], path[-1], [0, 0], HEADING_ONLY)
    assert bound == pytest.approx(runs_cost(path, [0, 0], HEADING_ONLY), rel=1e-6)
    assert bound < edge_cost(path[0], path[-1], [0, 0], HEADING_ONLY) * 0.99


def test_short_edges_far_from_the_goal_keep_their_digits():
    # A lever of 1000 m and a step of a micrometre: the cost is q_h |w|² ds up to second order in 1e-9.
    a = np.array([0.0, 0.0])
    for b in ([1e-6, 0.0], [0.0, 1e-6]):
        assert geodesic_cost(a, b, [1000.0, 0.0], HEADING_ONLY) == pytest.approx(1.0, rel=3e-9)
        assert edge_cost(a, b, [1000.0, 0.0], HEADING_ONLY) == pytest.approx(1.0, rel=3e-9)


def test_published_values_of_the_bracket():
    std = [0.1, 0.2, 0.5, 1.0, 1.5, 2.0, 3.0]
    expected = [0.9975, 0.99007, 0.94002, 0.78668, 0.59829, 0.42534, 0.19626]
    np.testing.assert_allclose(bracket(std), expected, atol=6e-6)


@pytest.mark.parametrize("std", [[0.1, np.nan], [np.inf, 0.1], [0.1, -0.1], np.nan, -1.0])
def test_no_bracket_of_what_is_no_standard_deviation(std):
    with pytest.raises(ValueError, match="expected heading_std_end >= 0 and finite"):
        bracket(std)


@given(st.floats(0, 30))
def test_the_bracket_lies_between_the_simple_bound_and_one(std):
    # For std of 30 the simple bound underflows the last digit of cos², which is 1e-16 of 1.
    assert np.exp(-(std**2) / 4) - 1e-15 <= bracket(std) <= 1


@given(st.floats(1e-3, 20))
def test_the_bracket_solves_its_equation(std):
    omega = np.sqrt(bracket(std) / (1 - bracket(std)))
    # ω tan(ω σ²/4) = 1; 1 - Λ carries an absolute 1e-16, so ω a relative 1e-16/(1 - Λ) >= 4e-10 at 1e-3 rad.
    assert np.arctan(1 / omega) == pytest.approx(omega * std**2 / 4, rel=1e-8)


def test_the_exact_error_lies_in_the_bracket():
    drift = pytest.importorskip("driftplan.model.drift", reason="the exact model is not there yet")
    rng = np.random.default_rng(5)
    ratios = []
    for case in range(200):
        path = rng.normal(0, 10, (rng.integers(2, 9), 2)).cumsum(axis=0)
        noise = OdometryNoise(
            heading_var_per_m=10 ** rng.uniform(-5, -1),
            heading_var_per_rad=10 ** rng.uniform(-4, -1) * (case % 2),
            distance_var_per_m=0.01 * (case % 3),
        )
        exact = drift.predict_drift(path, noise).end.rms ** 2
        length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        steps = np.diff(path, axis=0)
        headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
        variance = noise.heading_var_per_m * length + noise.heading_var_per_rad * np.abs(np.diff(headings)).sum()
        position = CostRates.of(noise).position * length
        world = World.from_polygons([], bounds=(-1e3, -1e3, 1e3, 1e3), robot_radius=0.1)
        heading_part = AdditiveCost(world, path[-1], noise).path(path) - position
        ratios.append((exact - position) / heading_part)
        # 1e-9: the exact value comes from composing elements, the cost from a sum.
        assert bracket(np.sqrt(variance)) - 1e-9 <= ratios[-1] <= 1 + 1e-9
    assert min(ratios) < 0.5  # both ends were put to the test
    assert max(ratios) > 0.99


def test_two_routes_of_equal_length_differ_by_the_closed_form():
    # Legs p (long) and q: long first costs ∫₀ᵖ (s² + q²) ds + q³/3 = p³/3 + q²p + q³/3, short first swaps p and q.
    p, q = 30.0, 10.0
    long_first = runs_cost([[0, 0], [p, 0], [p, q]], (p, q), HEADING_ONLY)
    short_first = runs_cost([[0, 0], [0, q], [p, q]], (p, q), HEADING_ONLY)
    assert long_first == pytest.approx(p**3 / 3 + q**2 * p + q**3 / 3)
    assert short_first == pytest.approx(p**3 / 3 + p**2 * q + q**3 / 3)
    # Over all proportions the gain in rms is greatest at q/p = 0.434..., where it is 18 %.
    ratio = np.linspace(0.01, 1, 991)
    gain = 1 - np.sqrt((1 / 3 + ratio**2 + ratio**3 / 3) / (1 / 3 + ratio + ratio**3 / 3))
    assert gain.max() == pytest.approx(0.18, abs=0.005)


# Noise that an additive cost can only approximate


def test_noise_per_step_enters_by_its_rate():
    steps = OdometryNoise.per_step(heading_std=0.1, distance_std=0.2, lateral_std=0.1, step_m=0.5)
    rates = CostRates.of(steps)
    assert (rates.heading, rates.position) == pytest.approx((0.02, 0.1))


def test_systematic_errors_and_correlation_are_not_priced():
    crooked = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3, heading_distance_corr=0.5,
                            heading_bias_per_m=1e-2, distance_scale_error=0.1)  # fmt: skip
    plain = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3)
    assert CostRates.of(crooked) == CostRates.of(plain)


# Bad input


@pytest.mark.parametrize("bad", [[np.nan, 0], [np.inf, 0], [1.0], [1, 2, 3, 4], [[1, 2, 3]], 5.0])
def test_points_that_are_not_points_are_refused(bad):
    for call in (
        lambda: edge_cost(bad, [0, 0], [1, 1], NOISE),
        lambda: geodesic_cost([0, 0], bad, [1, 1], NOISE),
        lambda: edge_cost([0, 0], [1, 0], bad, NOISE),
        lambda: turn_cost([0, 0], 1.0, bad, NOISE),
    ):
        with pytest.raises(ValueError, match="expected"):
            call()


@pytest.mark.parametrize("std", [-0.1, np.nan, np.inf])
def test_deviations_that_are_not_deviations_are_refused(std):
    with pytest.raises(ValueError, match="heading_std_end"):
        bracket(std)


def test_a_turn_that_is_not_a_number_is_refused():
    with pytest.raises(ValueError, match="turn_rad"):
        turn_cost([0, 0], np.nan, [1, 1], NOISE)


def test_noise_that_is_not_noise_is_refused():
    with pytest.raises(ValueError, match="OdometryNoise"):
        edge_cost([0, 0], [1, 1], [2, 2], 0.1)
