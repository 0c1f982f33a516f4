"""predict_drift against the published O(n²) double sums of the unbounded-drift paper (Table I, its misprints mended).

The double sums are written well in numpy: pairs of steps in blocks that fit the cache, upper triangle only, the kernel
exp(-(p - i) δ²/2) looked up rather than computed. A second rival factors the kernels, which the paper does not: what is
left is a triangular Toeplitz product, still O(n²). Both give the variance at the end of the path only; predict_drift
gives the whole covariance at every waypoint.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from driftplan import OdometryNoise, Runs, predict_drift
from driftplan.literature import proposition_1

HEADING_STD, DISTANCE_STD = 1e-3, 1e-2
NOISE = OdometryNoise.per_step(heading_std=HEADING_STD, distance_std=DISTANCE_STD, step_m=1.0)
STEPS = 10_000
_PAIRS = 16_384  # in a block: a handful of arrays of so many doubles stay in the cache


def seconds(work: Callable[[], object], repeat: int) -> float:
    """Best time of ``work`` after one warm-up: what else the machine does is not to count."""
    work()
    times = []
    for _ in range(repeat):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def single_sums(d: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, ...]:
    """What both rivals share: cos T and sin T times d, h, g, the entries A + D and C + F together, the squared mean."""
    i = np.arange(1, len(d) + 1)
    T = np.cumsum(turns)
    x, y = d * np.cos(T), d * np.sin(T)
    h, g = np.exp(-0.5 * i * HEADING_STD**2), np.exp(-2 * i * HEADING_STD**2)
    singles = np.sum(d**2 * (2 - 2 * h)) + len(d) * DISTANCE_STD**2
    mean = np.sum((x + 1j * y) * (h - 1))
    return x, y, h, g, singles, abs(mean) ** 2


def double_sum(d: np.ndarray, turns: np.ndarray) -> float:
    """Trace of the covariance, pair by pair as published."""
    x, y, h, g, singles, mean2 = single_sums(d, turns)
    n = len(d)
    fade = np.exp(-0.5 * np.arange(n) * HEADING_STD**2)
    B = E = 0.0
    lo = 0
    while lo < n:
        rows = np.arange(lo, min(lo + max(1, _PAIRS // (n - lo)), n))
        columns = np.arange(lo, n)
        lag = columns - rows[:, None]
        k = fade[np.abs(lag)]
        hi, gi = h[rows, None], g[rows, None]
        alpha = 1 - hi - hi * k + 0.5 * (1 + gi) * k
        beta = 0.5 * (1 - gi) * k
        later = lag > 0
        alpha *= later
        beta *= later
        B += y[rows] @ (alpha @ y[lo:]) + x[rows] @ (beta @ x[lo:])
        E += x[rows] @ (alpha @ x[lo:]) + y[rows] @ (beta @ y[lo:])
        lo = rows[-1] + 1
    return float(singles + 2 * (B + E) - mean2)


def factored_double_sum(d: np.ndarray, turns: np.ndarray) -> float:
    """The same with α + β = (1 - h)(1 + k) written out: one triangular Toeplitz product."""
    x, y, h, _, singles, mean2 = single_sums(d, turns)
    n = len(d)
    z = x + 1j * y
    fade = np.exp(-0.5 * np.arange(n, 0, -1) * HEADING_STD**2)  # of the lags n, n - 1, ..., 1
    weighted = z * (1 - h)
    both = np.stack([weighted.real, weighted.imag])
    faded = np.zeros(n, complex)
    for p in range(1, n):
        re, im = both[:, :p] @ fade[n - p :]
        faded[p] = complex(re, im)
    plain = np.cumsum(weighted) - weighted
    return float(singles + 2 * np.sum((plain + faded).conj() * z).real - mean2)


def main() -> None:
    print(
        f"{'path':34} {'steps':>7} {'predict_drift':>14} {'double sum':>11} {'ratio':>9} {'factored':>9} {'ratio':>7}"
    )
    for n in (1000, 3000, STEPS, 30_000):
        rng = np.random.default_rng(0)
        every = rng.uniform(0.5, 1.0, n), rng.normal(0, 0.05, n)
        bends = np.where(np.arange(n) % (n // 100) == 0, rng.normal(0, 1, n), 0.0)
        for name, (d, turns), path in (
            ("straight, one run", (np.ones(n), np.zeros(n)), Runs.from_odometry([float(n)], [0.0])),
            ("100 straight runs", (np.ones(n), bends), Runs.from_odometry(np.full(100, n / 100), bends[:: n // 100])),
            ("curvy, every step different", every, Runs.from_odometry(*every)),
        ):
            own = seconds(lambda path=path: predict_drift(path, NOISE).end.trace, 25)
            text = f"{name:34} {n:7d} {1e3 * own:11.2f} ms"
            exact = float(predict_drift(path, NOISE).end.trace)
            if n <= STEPS:
                spent = seconds(lambda d=d, turns=turns: double_sum(d, turns), 1)
                assert abs(double_sum(d, turns) / exact - 1) < 1e-6, "the rivals must agree"
                text += f" {spent:9.2f} s {spent / own:9.0f}"
            else:
                text += f" {'':>11} {'':>9}"
            spent = seconds(lambda d=d, turns=turns: factored_double_sum(d, turns), 1)
            assert abs(factored_double_sum(d, turns) / exact - 1) < 1e-6, "the rivals must agree"
            print(f"{text} {spent:7.2f} s {spent / own:7.0f}", flush=True)

    rng = np.random.default_rng(0)
    print("\nthe corrected Table I itself, in running sums: steps, time of proposition_1")
    for n in (10**3, 10**4, 10**5, 10**6):
        d, turns = rng.uniform(0.5, 1.0, n), rng.normal(0, 0.05, n)
        noise = {"heading_std_rad": HEADING_STD, "distance_std_m": DISTANCE_STD}
        spent = seconds(lambda d=d, turns=turns, noise=noise: proposition_1(d, turns, **noise), 3)
        print(f"{n:10d} {1e3 * spent:10.2f} ms")


if __name__ == "__main__":
    main()
