"""A robot with a filter: 10 000 readings on one path, of every kind; 1000 layouts of one route at once; against plain
matrices. Seconds of processor."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from driftplan import Fix, OdometryNoise, predict_drift
from driftplan.model.covariance import path_legs
from driftplan.model.filter_state import FilterState, position_rows, states_along
from driftplan.model.paths import read_path
from driftplan.model.readings import Readings

NOISE = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
TAG = position_rows(0.01 * np.eye(2))
STATIONS, LAYOUTS = 540, 1000


KINDS: dict[str, Callable[[float], Fix]] = {
    "position": lambda s: Fix.position(s, position_std_m=0.1),
    "position, axes askew": lambda s: Fix(s_m=s, position_cov=np.array([[0.01, 0.004], [0.004, 0.02]])),
    "position and heading": lambda s: Fix.full(s, position_std_m=0.1, heading_std=0.02),
    "range": lambda s: Fix.range(s, anchor=(3.0, 4.0), range_std_m=0.1),
    "bearing": lambda s: Fix.bearing(s, anchor=(3.0, 4.0), bearing_std=0.02),
    "position, nine of ten": lambda s: Fix.position(s, position_std_m=0.1, detection_probability=0.9),
}


def seconds(work: Callable[[], object], repeat: int = 5) -> float:
    """Least time of processor of ``work``."""
    times = []
    for _ in range(repeat):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return min(times)


def walk(waypoints: int) -> np.ndarray:
    return np.cumsum(np.random.default_rng(0).normal(size=(waypoints, 2)), axis=0)


def one_drive(path: np.ndarray) -> float:
    legs = path_legs(read_path(path), [NOISE]).columns()
    readings = {k: [(TAG, None)] for k in range(1, len(legs) + 1)}
    return float(states_along(FilterState.at_start(), legs, readings)[1].trace[-1])


def plain_matrices(path: np.ndarray) -> float:
    """The recursion as most would write it."""
    legs = path_legs(read_path(path), [NOISE])
    P, H, R = np.zeros((3, 3)), np.eye(3)[:2], 0.01 * np.eye(2)
    for A, C in zip(legs.A, legs.C, strict=True):
        P = A @ P @ A.T + C
        P = P - P @ H.T @ np.linalg.solve(H @ P @ H.T + R, H @ P)
    return float(P[0, 0] + P[1, 1])


def many_layouts(path: np.ndarray, read: np.ndarray) -> np.ndarray:
    state = FilterState.from_matrix(np.zeros((LAYOUTS, 3, 3)))
    worst = np.zeros(LAYOUTS)
    for leg, asked in zip(path_legs(read_path(path), [NOISE]).columns(), read, strict=True):
        state = state.driven(leg)
        worst = np.maximum(worst, state.trace)
        state = state.read(TAG, asked)
    return worst


def main() -> None:
    path = walk(10_001)
    here, plain = seconds(lambda: one_drive(path)), seconds(lambda: plain_matrices(path), 3)
    print(f"10 000 readings on one path: {here:.3f} s, plain matrices {plain:.3f} s ({plain / here:.1f} times as long)")
    print(f"relative difference of the end's variance: {one_drive(path) / plain_matrices(path) - 1:.1e}")
    s = np.cumsum(np.hypot(*np.diff(path, axis=0).T)) * (1 - 1e-12)
    for name, of in KINDS.items():
        readings = Readings.of([of(x) for x in s.tolist()])
        took = seconds(lambda readings=readings: predict_drift(path, NOISE, fixes=readings, estimator="filter"), 3)
        print(f"predict_drift with 10 000 readings, {name}: {took:.3f} s")
    route, read = walk(STATIONS + 1), (np.random.default_rng(1).random((STATIONS, LAYOUTS)) < 0.3).astype(float)
    layouts, alone = seconds(lambda: many_layouts(route, read), 3), seconds(lambda: one_drive(route), 3)
    print(f"{LAYOUTS} layouts of {STATIONS} stations: {layouts:.3f} s; one by one about {alone * LAYOUTS:.1f} s")


if __name__ == "__main__":
    main()
