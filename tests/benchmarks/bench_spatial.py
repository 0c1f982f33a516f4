"""predict_drift_3d: growth with the number of steps; against step-by-step composition, first-order propagation and
Monte Carlo in the same run; rows of equal steps; and the accuracy that goes with the speed."""

from __future__ import annotations

import time
from collections.abc import Callable

import mpmath as mp
import numpy as np

from driftplan.model.spatial.drift import predict_drift_3d, predict_flight_drift
from driftplan.model.spatial.moments import SpatialMoments
from driftplan.model.spatial.rotations import RotationNoise
from driftplan.model.spatial.simulation import simulate_drift_3d

COV = 1e-4 * np.eye(3)
TILTED = np.diag([1e-6, 2e-6, 5e-7])
LAWS = {
    "isotropic": RotationNoise.isotropic(1e-3),
    "von Mises-Fisher": RotationNoise.von_mises_fisher(4e6),
    "anisotropic": RotationNoise.anisotropic(TILTED),
}


def seconds(work: Callable[[], object], repeat: int = 3) -> float:
    """Median time of ``work`` after one warm-up."""
    work()
    times = []
    for _ in range(repeat):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


def motion(n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return RotationNoise.isotropic(0.05).sample(rng, n), rng.uniform(0.5, 1.0, (n, 1)) * [1.0, 0.1, 0.0]


def one_by_one(R: np.ndarray, t: np.ndarray) -> SpatialMoments:
    """The same algebra, composed step after step."""
    noise = SpatialMoments.of_step(LAWS["anisotropic"], np.zeros(3), COV)
    S, total = np.eye(3), SpatialMoments(*(np.zeros_like(x) for x in noise))
    for Rk, tk in zip(R, t, strict=True):
        S = S @ Rk
        total = total.append(noise.rotated(S[..., None]).moved((S @ tk)[:, None]))
    return total


def first_order(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Covariance of position and attitude by the usual linearised recursion P <- F P Fᵀ + Q, world-frame errors."""
    S, P, F, Q = np.eye(3), np.zeros((6, 6)), np.eye(6), np.zeros((6, 6))
    for Rk, tk in zip(R, t, strict=True):
        S = S @ Rk
        x, y, z = S @ tk
        Q[3:, 3:] = S @ TILTED @ S.T
        Q[:3, :3] = S @ COV @ S.T
        F[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        P[3:, 3:] += Q[3:, 3:]
        P = F @ P @ F.T
        P[:3, :3] += Q[:3, :3]
    return P


def accuracy(std: float, n: int = 1000) -> float:
    """Worst relative error of bias and E|e|² of n steps straight on against the sums in 50 digits."""
    with mp.workdps(50):
        x = mp.mpf(std) ** 2
        l1 = 1 - 2 * (1 - (1 - x) * mp.exp(-x / 2)) / 3
        reach = mp.fsum(l1**k for k in range(1, n + 1))
        square = n + 2 * mp.fsum((n - k) * l1**k for k in range(1, n)) - 2 * n * reach + mp.mpf(n) ** 2
        bias, square = float(reach - n), float(square)
    worst = 0.0
    laws = [RotationNoise.isotropic(std)] + ([RotationNoise.anisotropic(std**2 * np.eye(3))] if std <= 3 else [])
    for noise in laws:
        drift = predict_drift_3d(np.tile(np.eye(3), (n, 1, 1)), np.tile([1.0, 0, 0], (n, 1)), noise).end
        worst = max(worst, abs(drift.bias[0] / bias - 1), abs(drift.rms**2 / square - 1))
    return worst


def main() -> None:
    print("distinct steps, drift after every one of them [s]")
    print(f"{'n':>8}" + "".join(f"{name:>18}" for name in LAWS))
    for n in (100, 1000, 10_000, 100_000):
        R, t = motion(n)
        times = [seconds(lambda noise=noise, R=R, t=t: predict_drift_3d(R, t, noise, COV)) for noise in LAWS.values()]
        print(f"{n:>8}" + "".join(f"{x:>18.4f}" for x in times), flush=True)

    n = 10_000
    R, t = motion(n)
    mine = seconds(lambda: predict_drift_3d(R, t, LAWS["anisotropic"], COV))
    print(f"\n{n} steps, anisotropic: {mine:.3f} s; others take")
    drift = predict_drift_3d(R, t, LAWS["anisotropic"], COV).end
    exact = drift.rms
    begin = time.perf_counter()
    total = one_by_one(R, t)
    spent = time.perf_counter() - begin
    rms = np.trace(total.square[0]) ** 0.5
    print(f"  step by step, same algebra     {spent / mine:8.1f} times as long, rms off by {rms / exact - 1:+.1e}")
    begin = time.perf_counter()
    P = first_order(R, t)
    spent = time.perf_counter() - begin
    rms = np.trace(P[:3, :3]) ** 0.5
    print(f"  first-order (EKF) propagation  {spent / mine:8.1f} times as long, rms off by {rms / exact - 1:+.1e}")
    few = 1000
    begin = time.perf_counter()
    errors = simulate_drift_3d(R[:few], t[:few], LAWS["anisotropic"], COV, runs=1000)
    spent = (time.perf_counter() - begin) * n / few
    part = predict_drift_3d(R[:few], t[:few], LAWS["anisotropic"], COV).end.rms
    rms = (errors[:, -1] ** 2).sum(axis=-1).mean() ** 0.5
    print(f"  1000 Monte Carlo runs          {spent / mine:8.1f} times as long, rms off by {rms / part - 1:+.1e}")

    print("\nequal steps by squaring [ms]")
    for n in (10**3, 10**6, 10**9):
        times = [
            1e3 * seconds(lambda noise=noise, n=n: predict_drift_3d(R[:1], t[:1], noise, COV, repeats=n))
            for noise in LAWS.values()
        ]
        print(f"{n:>12}" + "".join(f"{x:>18.2f}" for x in times))
    path = np.cumsum(np.random.default_rng(0).normal(size=(100_000, 3)), axis=0)
    flight = seconds(lambda: predict_flight_drift(path, rotation_var_per_m=1e-6, distance_var_per_m=1e-4))
    print(f"\ncontinuous noise, 100000 waypoints: {flight:.3f} s")

    print("\nworst relative error of bias and E|e|² over 1000 steps against 50 digits")
    for std in (1e-12, 1e-8, 1e-4, 1e-2, 0.3, 1.0, 3.0, 10.0):
        print(f"  {std:8.0e} rad per step  {accuracy(std):.1e}")


if __name__ == "__main__":
    main()
