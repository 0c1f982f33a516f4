"""predict_drift against Monte Carlo, first-order (EKF) propagation and, where it installs, GTSAM marginals; growth
with the number of steps; batches; and the accuracy that goes with the speed."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from driftplan import OdometryNoise, Runs, predict_drift

STEPS = 10_000
NOISE = OdometryNoise.per_step(heading_std=1e-3, distance_std=1e-2, step_m=1.0)


def seconds(work: Callable[[], object], repeat: int = 5) -> float:
    """Median time of ``work`` after one warm-up."""
    work()
    times = []
    for _ in range(repeat):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


def log(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(0.5, 1.0, n), rng.normal(0, 0.05, n)


def monte_carlo(distances: np.ndarray, turns: np.ndarray, runs: int = 1000) -> float:
    """E|e|² of simulated drives, vectorised over the runs in blocks of steps."""
    rng = np.random.default_rng(0)
    true = np.cumsum(turns)
    end = np.zeros(runs, complex)
    theta = np.zeros((runs, 1))
    for lo in range(0, len(turns), 1000):
        d, T = distances[lo : lo + 1000], true[lo : lo + 1000]
        errors = theta + np.cumsum(rng.normal(0, NOISE.heading_var_per_step**0.5, (runs, len(d))), axis=1)
        moved = d + rng.normal(0, NOISE.distance_var_per_step**0.5, (runs, len(d)))
        end += (moved * np.exp(1j * (errors + T))).sum(axis=1)
        theta = errors[:, -1:]
    return float(np.mean(np.abs(end - np.sum(distances * np.exp(1j * true))) ** 2))


def ekf(distances: np.ndarray, turns: np.ndarray) -> float:
    """Trace of the position covariance of the usual first-order recursion P ← F P Fᵀ + G Q Gᵀ."""
    P, theta = np.zeros((3, 3)), 0.0
    Q = np.diag([NOISE.distance_var_per_step, NOISE.heading_var_per_step])
    F, G = np.eye(3), np.zeros((3, 2))
    G[2, 1] = 1.0
    for d, turn in zip(distances.tolist(), turns.tolist(), strict=True):
        theta += turn
        c, s = np.cos(theta), np.sin(theta)
        F[0, 2], F[1, 2] = -d * s, d * c
        G[0, 0], G[1, 0], G[0, 1], G[1, 1] = c, s, -d * s, d * c
        P = F @ P @ F.T + G @ Q @ G.T
    return float(P[0, 0] + P[1, 1])


def gtsam_marginals(distances: np.ndarray, turns: np.ndarray) -> float:
    """Trace of the end's marginal covariance in a chain of odometry factors."""
    import gtsam

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    prior = gtsam.noiseModel.Diagonal.Sigmas(np.full(3, 1e-3))
    pose = gtsam.Pose2()
    graph.add(gtsam.PriorFactorPose2(0, pose, prior))
    values.insert(0, pose)
    for k, (d, turn) in enumerate(zip(distances.tolist(), turns.tolist(), strict=True)):
        step = gtsam.Pose2(0, 0, turn).compose(gtsam.Pose2(d, 0, 0))
        std = np.array(
            [NOISE.distance_var_per_step**0.5, d * NOISE.heading_var_per_step**0.5, NOISE.heading_var_per_step**0.5]
        )
        graph.add(gtsam.BetweenFactorPose2(k, k + 1, step, gtsam.noiseModel.Diagonal.Sigmas(std)))
        pose = pose.compose(step)
        values.insert(k + 1, pose)
    cov = gtsam.Marginals(graph, values).marginalCovariance(len(turns))
    return float(np.trace(cov[:2, :2]))


def main() -> None:
    distances, turns = log(STEPS)
    runs = Runs.from_odometry(distances, turns)
    own = seconds(lambda: predict_drift(runs, NOISE))
    exact = float(predict_drift(runs, NOISE).end.rms ** 2)
    print(f"{STEPS} distinct odometry steps, drift at every one of them: {1e3 * own:.2f} ms")
    print(f"{'method':32} {'time [s]':>9} {'ratio':>9} {'E|e|² error':>12}")
    for name, rival in (("1000 Monte Carlo runs, numpy", monte_carlo), ("first-order EKF recursion", ekf)):
        spent = seconds(lambda rival=rival: rival(distances, turns), 1)
        print(f"{name:32} {spent:9.3f} {spent / own:9.0f} {100 * (rival(distances, turns) / exact - 1):11.2f}%")
    against_gtsam(*log(1000))  # with 10 000 steps its linear system is reported as indeterminate

    corners = np.array([(0, 0), (2500, 0), (2500, 2500), (0, 2500), (0, 1)], dtype=float)
    few = seconds(lambda: predict_drift(corners, NOISE))
    as_steps = Runs.from_odometry(np.ones(9999), np.where(np.arange(9999) % 2500 == 0, np.pi / 2, 0.0))
    sampled = seconds(lambda: monte_carlo(as_steps.lengths, as_steps.turns), 1)
    print(f"as many steps in four straight runs: {1e3 * few:.2f} ms, {sampled / few:.0f} times faster than 1000 runs")

    print("\ngrowth: steps, time for one straight run, time for as many distinct steps")
    for n in (10**2, 10**3, 10**4, 10**5, 10**6, 10**9):
        straight = seconds(lambda n=n: predict_drift([(0, 0), (float(n), 0)], NOISE).end.rms)
        text = f"{n:12d} {1e3 * straight:9.2f} ms"
        if n <= 10**6:
            dense = Runs.from_odometry(*log(n))
            text += f" {1e3 * seconds(lambda dense=dense: predict_drift(dense, NOISE), 3):10.2f} ms"
        print(text)

    routes = np.cumsum(np.random.default_rng(1).normal(0, 3, (10_000, 50, 2)), axis=1)
    plain = OdometryNoise(heading_var_per_m=1e-5, distance_var_per_m=1e-4)
    turning = OdometryNoise(heading_var_per_m=1e-5, distance_var_per_m=1e-4, heading_var_per_rad=1e-4)
    for name, noise in (("noise per metre", plain), ("and per radian", turning)):
        spent = seconds(lambda n=noise: predict_drift(routes, n).end.rms, 3)
        print(f"10 000 routes of 50 waypoints, {name}: {spent:.2f} s")

    print("\nworst relative error against 150-digit arithmetic (heading error at the end of the run, rad)")
    print("  " + "  ".join(f"{std:.0e}: {err:.0e}" for std, err in accuracy()))


def against_gtsam(distances: np.ndarray, turns: np.ndarray) -> None:
    if not find_spec("gtsam"):
        print("GTSAM: not installed here")
        return
    runs = Runs.from_odometry(distances, turns)
    own, exact = seconds(lambda: predict_drift(runs, NOISE)), float(predict_drift(runs, NOISE).end.rms ** 2)
    spent = seconds(lambda: gtsam_marginals(distances, turns), 1)
    error = gtsam_marginals(distances, turns) / exact - 1
    print(f"{'GTSAM marginals, 1000 steps':32} {spent:9.3f} {spent / own:9.0f} {100 * error:11.2f}%")


def accuracy() -> list[tuple[float, float]]:
    """E|e|² of a straight run with heading noise only, against the closed form in exponentials with 150 digits."""
    import mpmath as mp

    found = []
    with mp.workdps(150):
        for std in (1e-12, 1e-9, 1e-6, 1e-3, 0.1, 1.0, 10.0):
            q = std**2 / 7.0
            x = mp.mpf(q) * 7
            exact = 49 * (1 + 4 / x - (4 / x + 8 / x**2) * (1 - mp.exp(-x / 2)))
            N = predict_drift([(0, 0), (7, 0)], OdometryNoise(heading_var_per_m=q)).end.moments.N
            found.append((std, float(abs(mp.mpf(float(N)) / exact - 1))))
    return found


if __name__ == "__main__":
    main()
