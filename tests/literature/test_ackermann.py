"""The Ackermann step and drive: against quadrature, published digits and Monte Carlo, and the erratum's recursion with
and without the covariance it leaves out."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.literature import AckermannDrift, StepNoise, ackermann_drift, ackermann_step, step_moments
from driftplan.model.moments import Moments, power

CAR = {"wheelbase_m": 2.5, "distance_std_m": 0.03, "steering_std_rad": 0.05}


def two_dimensional_quadrature(
    d: float, phi: float, *, wheelbase_m, distance_std_m, steering_std_rad
) -> dict[str, complex]:
    """Moments of one step by averaging over both errors, with nothing worked out by hand."""
    x, w = np.polynomial.hermite_e.hermegauss(60)
    weight = np.outer(w, w) / w.sum() ** 2
    measured = d + distance_std_m * x[:, None]
    heading = measured * np.tan(phi + steering_std_rad * x[None]) / wheelbase_m
    true = d * np.tan(phi) / wheelbase_m
    delta = np.exp(1j * (heading - true)) - 1
    e = measured * np.exp(1j * heading) - d * np.exp(1j * true)
    of = {"d1": delta, "d2": delta**2, "D": np.abs(delta) ** 2, "e1": e, "N": np.abs(e) ** 2, "e2": e**2}
    of |= {"a": e * delta.conj(), "b": e * delta}
    return {name: complex((weight * f).sum()) for name, f in of.items()}


@pytest.mark.parametrize(("phi", "steering_std"), [(0.0, 0.02), (0.3, 0.1), (-0.5, 0.1), (0.6, 0.1)])
def test_a_step_is_what_quadrature_over_both_errors_gives(phi, steering_std):
    car = CAR | {"steering_std_rad": steering_std, "distance_std_m": 0.1}
    step = ackermann_step(0.5, phi, **car)
    for name, value in two_dimensional_quadrature(0.5, phi, **car).items():
        # against the scale of its kind: some moments pass through zero
        scale = {"d1": step.D, "d2": step.D, "D": step.D, "e1": step.N**0.5, "a": (step.D * step.N) ** 0.5}
        atol = 1e-11 * float(scale.get(name, (step.D * step.N) ** 0.5 if name == "b" else step.N))
        assert complex(getattr(step, name)) == pytest.approx(value, abs=atol), name


def test_a_hundred_steps_have_the_reference_digits():
    car = {"wheelbase_m": 2.5, "distance_std_m": 0.02, "steering_std_rad": 0.02}
    end = power(ackermann_step(0.5, 0.2, **car), 100)
    assert complex(end.p) == pytest.approx(-10.158153213492 + 19.676226235385194j, rel=1e-12)
    assert complex(end.e1) == pytest.approx(0.005218329403189 - 0.030606780136414j, rel=1e-10)
    assert float(end.N.real) == pytest.approx(0.677156668516, rel=1e-11)
    assert complex(end.e2) == pytest.approx(-0.288053910036807 + 0.373072321818963j, rel=1e-11)
    drift = ackermann_drift([0.5] * 100, [0.2] * 100, **car)
    assert float(drift.rms[-1] ** 2) == pytest.approx(0.677156668516, rel=1e-11)


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 10**9), n=st.integers(1, 60))
def test_the_recursion_of_the_erratum_closes_with_the_cross_covariance(seed, n):
    rng = np.random.default_rng(seed)
    drift = ackermann_drift(
        rng.uniform(0.1, 1, n),
        rng.uniform(-0.4, 0.4, n),
        wheelbase_m=rng.uniform(1, 4),
        distance_std_m=10 ** rng.uniform(-6, -0.5),
        steering_std_rad=10 ** rng.uniform(-6, -1),
    )
    cross = drift.cross_cov
    np.testing.assert_allclose(
        np.diff(drift.cov, axis=0),
        drift.increment_cov + cross + cross.swapaxes(-1, -2),
        atol=1e-12 * float(drift.rms[-1] ** 2),  # round-off of differences of the covariance
    )


@cache
def drives(phi: float, distance_std: float, steering_std: float, n: int, runs: int = 30_000):
    """Errors, positions before the last step, and last displacements of simulated drives: steps of 0.5 m, L = 2.5 m."""
    rng = np.random.default_rng(3)
    heading, position = np.zeros(runs), np.zeros(runs, complex)
    for _ in range(n):
        before = position.copy()
        measured = 0.5 + rng.normal(0, distance_std, runs)
        heading += measured * np.tan(phi + rng.normal(0, steering_std, runs)) / 2.5
        position += measured * np.exp(1j * heading)
    true = 0.5 * np.exp(0.5j * np.tan(phi) / 2.5 * np.arange(1, n + 1)).sum()
    return position - true, before, position - before


def as_drift(phi: float, distance_std: float, steering_std: float, n: int) -> AckermannDrift:
    return ackermann_drift(
        np.full(n, 0.5), np.full(n, phi), wheelbase_m=2.5, distance_std_m=distance_std, steering_std_rad=steering_std
    )


def deviations(samples: np.ndarray, value: float) -> float:
    return float(abs(samples.mean() - value) / (samples.std() / len(samples) ** 0.5))


def planar(z: np.ndarray) -> np.ndarray:
    return np.stack([z.real, z.imag], axis=-1)


CASE = (0.3, 0.03, 0.1, 60)


def test_a_drive_is_confirmed_by_simulation():
    drift, (e, before, last) = as_drift(*CASE), drives(*CASE)
    assert deviations(e.real, drift.bias[-1, 0]) < 4
    assert deviations(e.imag, drift.bias[-1, 1]) < 4
    e, before, last = (planar(z) - planar(z).mean(0) for z in (e, before, last))
    for i in range(2):
        for j in range(2):
            assert deviations(e[:, i] * e[:, j], drift.cov[-1, i, j]) < 4
            assert deviations(last[:, i] * last[:, j], drift.increment_cov[-1, i, j]) < 4
            assert deviations(before[:, i] * last[:, j], drift.cross_cov[-1, i, j]) < 4


def test_leaving_the_cross_covariance_out_is_refuted_by_simulation():
    """Misprint 2."""
    straight = (0.0, 0.01, 0.01, 200)
    drift, (e, _, _) = as_drift(*straight), drives(*straight)
    squares = np.abs(e - complex(*drift.bias[-1])) ** 2
    variance, without = np.trace(drift.cov[-1]), np.trace(drift.increment_cov.sum(0))
    assert deviations(squares, variance) < 4
    assert deviations(squares, without) > 50
    assert variance / without == pytest.approx(67.5, abs=0.05)


@pytest.mark.parametrize("n", [10, 50, 200, 400])
def test_for_heading_noise_alone_it_leaves_out_two_thirds_of_the_steps(n):
    drift = as_drift(0.0, 0.0, 1e-3, n)
    ratio = np.trace(drift.cov[-1]) / np.trace(drift.increment_cov.sum(0))
    assert ratio == pytest.approx((2 * n + 1) / 3, rel=1e-4)  # to first order in the heading variance


def step_with_the_tangent_of_the_erratum(d: float, phi: float, car: dict[str, float]) -> Moments:
    """As printed: tan(φ + ε) = tan φ + sec² φ tan ε. One step by quadrature over both errors."""
    x, w = np.polynomial.hermite_e.hermegauss(60)
    weight = np.outer(w, w) / w.sum() ** 2
    measured = d + car["distance_std_m"] * x[:, None]
    tangent = np.tan(phi) + np.tan(car["steering_std_rad"] * x[None]) / np.cos(phi) ** 2
    heading, true = measured * tangent / car["wheelbase_m"], d * np.tan(phi) / car["wheelbase_m"]
    r = np.exp(1j * (heading - true))
    s = r * (measured - d)

    def mean(f):
        return complex((weight * f).sum())

    noise = StepNoise(
        d1=mean(r - 1),
        d2=mean((r - 1) ** 2),
        D=mean(np.abs(r - 1) ** 2).real,
        s1=mean(s),
        S=mean(np.abs(s) ** 2).real,
        s2=mean(s**2),
        a=mean(s * (r - 1).conj()),
        b=mean(s * (r - 1)),
    )
    return step_moments(true, (d, 0.0), noise)


def test_the_tangent_of_the_erratum_is_refuted_by_simulation():
    """Misprint 1."""
    case = (0.5, 0.01, 0.1, 100)
    car = {"wheelbase_m": 2.5, "distance_std_m": 0.01, "steering_std_rad": 0.1}
    e, _, _ = drives(*case)
    bias = as_drift(*case).bias[-1]
    assert deviations(e.real, bias[0]) < 4
    assert deviations(e.imag, bias[1]) < 4
    printed = complex(power(step_with_the_tangent_of_the_erratum(0.5, 0.5, car), 100).e1)
    assert max(deviations(e.real, printed.real), deviations(e.imag, printed.imag)) > 50


def test_the_tangent_of_the_erratum_loses_the_mean_turn():
    car = {"wheelbase_m": 2.5, "distance_std_m": 0.01, "steering_std_rad": 0.1}
    exact, printed = ackermann_step(0.5, 0.5, **car), step_with_the_tangent_of_the_erratum(0.5, 0.5, car)
    assert abs(complex(power(exact, 100).e1)) == pytest.approx(0.739, abs=5e-4)
    assert abs(complex(power(printed, 100).e1)) == pytest.approx(0.172, abs=5e-4)
    lost = 0.5 * np.tan(0.5) / np.cos(0.5) ** 2 * 0.1**2 / 2.5
    assert float(exact.d1.imag - printed.d1.imag) == pytest.approx(lost, rel=0.05)  # next order: σ_φ⁴


def test_taking_the_errors_of_a_step_as_independent_is_refuted_by_simulation():
    case = (0.3, 0.1, 0.02, 100)
    car = {"wheelbase_m": 2.5, "distance_std_m": 0.1, "steering_std_rad": 0.02}
    exact = ackermann_step(0.5, 0.3, **car)
    u, v = complex(exact.u), 0.1**2
    d1, d2 = complex(exact.d1), complex(exact.d2)
    alone = StepNoise(d1=d1, d2=d2, D=-2 * d1.real, S=v, s2=(1 + 2 * d1 + d2) * v)
    independent = step_moments(np.angle(u), (0.5, 0.0), alone)
    e, _, _ = drives(*case)
    squares = np.abs(e) ** 2
    assert float(power(exact, 100).N.real) == pytest.approx(1.262, abs=5e-4)
    assert float(power(independent, 100).N.real) == pytest.approx(3.291, abs=5e-4)
    assert deviations(squares, float(power(exact, 100).N.real)) < 4
    assert deviations(squares, float(power(independent, 100).N.real)) > 50


def test_without_noise_there_is_no_drift():
    drift = ackermann_drift([0.5, 0.4], [0.2, -0.1], wheelbase_m=2.5, distance_std_m=0.0, steering_std_rad=0.0)
    for array in (drift.bias, drift.cov, drift.increment_cov, drift.cross_cov):
        assert not array.any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"distances_m": []}, r"distances_m of shape \(n,\)"),
        ({"distances_m": [0.5]}, "distances_m and steering_rad of one shape"),
        ({"steering_rad": [0.1, np.nan]}, "steering_rad finite"),
        ({"wheelbase_m": 0.0}, "wheelbase_m > 0"),
        ({"distance_std_m": -1.0}, "distance_std_m >= 0"),
        ({"steering_rad": [0.1, 1.6]}, "steering within ±90° whatever its error"),
        ({"steering_std_rad": 0.3}, "lower steering_rad or steering_std_rad"),
    ],
)
def test_bad_input_is_named(change, message):
    with pytest.raises(ValueError, match=message):
        ackermann_drift(**({"distances_m": [0.5, 0.5], "steering_rad": [0.1, 0.1]} | CAR | change))
