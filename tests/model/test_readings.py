"""Readings as arrays, and what each estimator makes of one: against averages over errors, and matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from driftplan.model.drift import predict_drift
from driftplan.model.filter_state import FilterState
from driftplan.model.moments import Moments
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix, Readings, start_errors

COV = np.array([[0.04, 0.01], [0.01, 0.09]])
FIXES = [
    Fix(s_m=4.0, position_cov=COV, heading_std=0.3, detection_probability=0.6),
    Fix(s_m=1.0, position_cov=COV),
    Fix.heading(9.0, heading_std=0.5, detection_probability=0.25),
    Fix.range(2.0, anchor=(3.0, -4.0), range_std_m=0.1),
    Fix(s_m=2.0, anchor=(-1.0, 2.0), range_std_m=0.2, bearing_std=0.05, heading_std=0.1, detection_probability=0.9),
]
FIELDS = ("s_m", "position_cov", "heading_std", "detection_probability", "range_std_m", "bearing_std", "anchor")


def moments_of(e: np.ndarray, d: np.ndarray) -> dict[str, complex]:
    """Averages over a sample of errors."""
    values = {"d1": d, "d2": d * d, "D": abs(d) ** 2, "e1": e, "N": abs(e) ** 2, "e2": e * e}
    return {name: value.mean() for name, value in (values | {"a": e * np.conj(d), "b": e * d}).items()}


@pytest.mark.parametrize("fix", FIXES[:3])
@pytest.mark.parametrize("chance", [0.0, 0.35, 1.0])
def test_a_reading_that_resets_replaces_what_it_measures_in_the_share_of_drives_that_read_it(fix, chance):
    rng = np.random.default_rng(1)
    theta = rng.normal(0.2, 0.4, 40)
    e, d = rng.normal(0.3, 1, 40) + 1j * rng.normal(size=40) + theta, np.exp(1j * theta) - 1
    old = moments_of(e, d)
    # fresh errors: a heading by quadrature, a position at four points that have its covariance
    x, weight = np.polynomial.hermite_e.hermegauss(40)
    fresh_d, w = np.exp(1j * (fix.heading_std or 0.0) * x) - 1, weight / weight.sum()
    root = np.linalg.cholesky(COV) @ np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]]) * np.sqrt(2)
    fresh_e = root[0] + 1j * root[1]
    new = dict(old)
    if fix.heading_std is not None:
        new |= {"d1": w @ fresh_d, "d2": w @ fresh_d**2, "D": w @ abs(fresh_d) ** 2}
    if fix.position_cov is not None:
        new |= {"e1": 0.0, "N": (abs(fresh_e) ** 2).mean(), "e2": (fresh_e**2).mean()}
    if fix.position_cov is not None or fix.heading_std is not None:  # what is fresh is independent
        new |= {"a": new["e1"] * np.conj(new["d1"]), "b": new["e1"] * new["d1"]}
    readings = Readings.of(
        [Fix(s_m=3.0, position_cov=fix.position_cov, heading_std=fix.heading_std, detection_probability=chance)]
    )
    after = readings.resets()[0].apply(Moments(1j, 2.0 + 1j, *old.values()))
    assert (after.u, after.p) == (1j, 2.0 + 1j)
    for name, value in old.items():
        expected = chance * new[name] + (1 - chance) * value
        assert complex(getattr(after, name)) == pytest.approx(complex(expected), rel=1e-10, abs=1e-14), name
    (numbers,) = readings.resets().numbers()
    one_by_one = numbers.apply(Moments(1j, 2.0 + 1j, *old.values()))
    assert one_by_one.arrays() == pytest.approx(after.arrays())


def _named(readings: Readings):
    return zip(Readings.__slots__, readings.arrays(), strict=True)


def test_fixes_become_readings_and_fixes_again_in_driving_order():
    readings = Readings.of(FIXES)
    assert readings.source.tolist() == [0, 1, 2, 3, 4]
    assert (readings.rank == -1).all()
    assert readings.read_position.tolist() == [True, True, False, False, False]
    assert readings.read_heading.tolist() == [True, False, True, False, True]
    for fix, k in zip(readings.fixes(), (1, 3, 4, 0, 2), strict=True):
        for name in FIELDS:
            found, expected = getattr(fix, name), getattr(FIXES[k], name)
            assert (found is None) == (expected is None), name
            if expected is not None:
                np.testing.assert_allclose(found, expected, rtol=1e-12, err_msg=name)
    later = Readings(*(x if name != "rank" else x + 3 for name, x in _named(readings)))
    both = later + readings
    assert len(both) == 10
    at_two = [fix.anchor.tolist() for fix in both.fixes() if fix.s_m == 2.0]
    assert at_two == [[3.0, -4.0], [-1.0, 2.0], [3.0, -4.0], [-1.0, 2.0]]
    ranked = Readings.of([replace(FIXES[0], detection_probability=p) for p in (0.1, 0.2, 0.3)])
    ranked = Readings(*(x if name != "rank" else np.array([5, 1, 3]) for name, x in _named(ranked)))
    assert [fix.detection_probability for fix in ranked.fixes()] == [0.2, 0.3, 0.1]  # at one place by rank
    assert [len(readings[some]) for some in (slice(1, 3), [0], np.array([], dtype=int))] == [2, 1, 0]


@pytest.mark.parametrize("k", range(len(FIXES)))
def test_a_filter_learns_of_a_reading_what_its_matrices_say(k):
    fix, place = FIXES[k], 1.0 + 0.5j
    ((rows, chance),) = Readings.of([fix]).rows(np.array([place]))
    assert chance == (None if fix.detection_probability == 1 else fix.detection_probability)
    information = np.zeros((3, 3))
    if fix.position_cov is not None:
        information[:2, :2] += np.linalg.inv(fix.position_cov)
    if fix.heading_std is not None:
        information[2, 2] += fix.heading_std**-2
    if fix.anchor is not None:
        away = fix.anchor - [place.real, place.imag]
        rho = np.hypot(*away)
        if fix.range_std_m is not None:
            h = np.array([*-away, 0.0]) / rho
            information += np.outer(h, h) / fix.range_std_m**2
        if fix.bearing_std is not None:
            h = np.array([away[1] / rho**2, -away[0] / rho**2, -1.0])
            information += np.outer(h, h) / fix.bearing_std**2
    P = np.array([[0.3, 0.1, 0.05], [0.1, 0.2, -0.03], [0.05, -0.03, 0.04]])
    np.testing.assert_allclose(
        FilterState.from_matrix(P).read(rows).matrix, np.linalg.inv(np.linalg.inv(P) + information), rtol=1e-9
    )


def test_ranges_and_bearings_from_within_a_centimetre_of_their_anchor_are_left_out():
    both = Fix(s_m=0.0, anchor=(3.0, 4.0), range_std_m=0.1, bearing_std=0.1)
    readings = Readings.of([both] * 3)
    counts = [len(rows) for rows, _ in readings.rows(3 + 4j + np.array([0.0, 0.0099j, 0.0101]))]
    assert counts == [0, 0, 2]
    ((at_a_centimetre, _),) = Readings.of([Fix.range(0.0, anchor=(0.0, 0.0), range_std_m=0.1)]).rows(np.array([0.01j]))
    assert at_a_centimetre == ()


def test_ranges_and_bearings_do_not_reset_and_other_estimators_there_are_none():
    for fix in (FIXES[3], Fix.bearing(2.0, anchor=(1.0, 1.0), bearing_std=0.1)):
        with pytest.raises(ValueError, match="estimator='filter'"):
            Readings.of([FIXES[0], fix]).resets()
    for wrong in ("Reset", ["filter"], None):
        with pytest.raises(ValueError, match="expected estimator one of"):
            predict_drift([(0, 0), (1, 0)], OdometryNoise(), estimator=wrong)


def test_a_start_is_known_as_its_fix_says():
    assert float(start_errors(None).N) == 0.0
    start = start_errors(FIXES[1])
    assert float(start.N) == pytest.approx(0.13)
    assert complex(start.e2) == pytest.approx(-0.05 + 0.02j)
    assert float(start.D) == 0.0


@pytest.mark.parametrize("p", [-0.01, 1.01])
def test_chances_are_from_nothing_to_certainty(p):
    for certain in (0, 1):
        assert Fix.position(1.0, position_std_m=0.1, detection_probability=certain).detection_probability == certain
    with pytest.raises(ValueError, match=r"in \[0, 1\]"):
        Fix.position(1.0, position_std_m=0.1, detection_probability=p)


def test_what_a_fix_holds_is_its_own_and_stays():
    anchor, cov = np.array([1.0, 2.0]), COV.copy()
    ranged, placed = Fix.range(1.0, anchor=anchor, range_std_m=0.1), Fix(s_m=1.0, position_cov=cov)
    anchor[0], cov[0, 0] = 9.0, 9.0
    assert ranged.anchor[0] == 1.0
    assert placed.position_cov[0, 0] == COV[0, 0]
    for held in (ranged.anchor, placed.position_cov):
        with pytest.raises(ValueError, match="read-only"):
            held[0] = 5.0
