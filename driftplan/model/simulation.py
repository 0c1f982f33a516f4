"""Monte Carlo dead reckoning: the independent oracle for `drift`. It shares the reading of paths, and no formula."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats
from driftplan.model.noise import Noises, OdometryNoise, noise_of_legs, steps_in
from driftplan.model.paths import Runs, read_path
from driftplan.model.readings import Fix


def simulate_drift(
    path: Any,
    noise: Noises,
    *,
    runs: int = 1000,
    rng: np.random.Generator | int = 0,
    start_heading: float | ArrayLike | None = None,
    fixes: Sequence[Fix] = (),
    substep_m: float | None = None,
) -> Floats:
    """Position errors at every waypoint of a path in ``runs`` simulated drives.

    Parameters
    ----------
    path, noise, start_heading, fixes :
        As for `predict_drift`; one path.
    runs : int
        Number of drives.
    rng : numpy.random.Generator or seed
    substep_m : float, optional
        In the continuous model each run is driven in substeps of at most this length (default: 1/400 of the path),
        with half of a substep's heading error before and half after it moves: the error of E|e|² falls with the square
        of the length.

    Returns
    -------
    array, shape (runs, n, 2)
        Estimated minus true position in metres, world frame. At a waypoint with a fix: after it.

    Examples
    --------
    >>> errors = simulate_drift([(0, 0), (10, 0)], OdometryNoise(distance_var_per_m=0.01), runs=4000, rng=1)
    >>> errors.shape, round(float(errors[:, -1, 0].std()), 2)  # sqrt(0.01 * 10) = 0.316
    ((4000, 2, 2), 0.32)
    """
    if isinstance(runs, bool) or not isinstance(runs, (int, np.integer)) or runs < 1:
        raise ValueError(f"expected runs a whole number >= 1, got {runs!r}")
    if substep_m is not None and not substep_m > 0:
        raise ValueError(f"expected substep_m > 0, got {substep_m!r}")
    legs = read_path(path, start_heading)
    if legs.lengths.ndim != 1:
        raise ValueError(f"expected one path, got a batch of shape {legs.lengths.shape[:-1]}: simulate one by one")
    waypoints = np.arange(0, len(legs.lengths) + 1, legs.legs_per_waypoint)
    noises, which = noise_of_legs(noise, len(legs.lengths), legs.legs_per_waypoint)
    due: dict[int, list[Fix]] = {}
    if fixes:
        ordered = sorted(fixes, key=lambda fix: fix.s_m)
        legs, at, borders = legs.cut(np.array([fix.s_m for fix in ordered]))
        waypoints, which = borders[waypoints], np.repeat(which, np.diff(borders))
        for border, fix in zip(at.tolist(), ordered, strict=True):
            due.setdefault(border, []).append(fix)
    of_leg = [noises[k] for k in which.tolist()]
    return _Drives(of_leg, runs, np.random.default_rng(rng), legs, substep_m).errors(due)[:, waypoints]


class _Drives:
    """Many drives at once: heading error and estimated position of each, beside the one true pose."""

    def __init__(
        self, noises: list[OdometryNoise], count: int, rng: np.random.Generator, legs: Runs, substep_m: float | None
    ) -> None:
        self.noises, self.rng, self.legs, self.count = noises, rng, legs, count
        self.substep_m = substep_m or max(float(legs.lengths.sum()), 1e-300) / 400
        self.theta = np.zeros(count)  # heading error
        self.p_hat = np.full(count, complex(legs.start))
        self.p = complex(legs.start)
        self.u = complex(np.exp(1j * legs.heading))
        varies = any(noise.varies_between_drives for noise in noises)
        self.deviations = rng.standard_normal((3, count)) if varies else np.zeros((3, 1))  # of each drive, for good

    def errors(self, due: dict[int, list[Fix]]) -> Floats:
        out = np.empty((self.count, len(self.legs.lengths) + 1, 2))
        for border in range(len(self.legs.lengths) + 1):
            if border > 0:
                k = border - 1
                self.noise = self.noises[k]
                self._turn(float(self.legs.turns[k]))
                self._run(float(self.legs.lengths[k]), float(self.legs.curvatures[k]))
            for fix in due.get(border, ()):
                self._fix(fix)
            e = self.p_hat - self.p
            out[:, border] = np.stack([e.real, e.imag], axis=-1)
        return out

    def _turn(self, turn: float) -> None:
        noise = self.noise
        if turn == 0:
            return
        pieces = 1
        if noise.step_m is None and noise.distance_var_per_rad > 0:
            pieces = int(np.ceil(abs(turn) / 0.02))  # the distance errors point where the robot then faces
        piece = turn / pieces
        for _ in range(pieces):
            self._move(
                piece,
                0.0,
                heading_var=noise.heading_var_per_rad * abs(piece),
                heading_mean=(noise.heading_bias_per_rad + self.deviations[1] * noise.heading_bias_std_per_rad) * piece,
                distance_var=noise.distance_var_per_rad * abs(piece),
                lateral_var=0.0,
            )

    def _run(self, length: float, curvature: float) -> None:
        noise = self.noise
        if length == 0:
            return
        steps = int(steps_in(length, noise.step_m if noise.step_m is not None else self.substep_m))
        d = length / steps
        bend = abs(curvature)
        per_step = noise.step_m is not None
        bias_per_m = noise.heading_bias_per_m + self.deviations[0] * noise.heading_bias_std_per_m
        bias_per_rad = noise.heading_bias_per_rad + self.deviations[1] * noise.heading_bias_std_per_rad
        for _ in range(steps):
            self._move(
                curvature * d,
                d,
                heading_var=noise.heading_var_per_step * per_step
                + (noise.heading_var_per_m + noise.heading_var_per_rad * bend) * d,
                heading_mean=(bias_per_m + bias_per_rad * curvature) * d,
                distance_var=noise.distance_var_per_step * per_step
                + (noise.distance_var_per_m + noise.distance_var_per_rad * bend) * d,
                lateral_var=noise.lateral_var_per_step * per_step + noise.lateral_var_per_m * d,
            )

    def _move(
        self,
        turn: float,
        length: float,
        *,
        heading_var: float,
        heading_mean: Floats,
        distance_var: float,
        lateral_var: float,
    ) -> None:
        """One true arc and its estimates: all of a step's heading error first (step model), or half of it."""
        noise = self.noise
        random_part = self._heading_errors(heading_var)
        change = random_part + heading_mean
        fresh = self.rng.standard_normal(self.count)
        if noise.heading_distance_corr and heading_var > 0:
            rho = noise.heading_distance_corr
            fresh = rho * random_part / np.sqrt(heading_var) + np.sqrt(1 - rho * rho) * fresh
        chord = length if turn == 0 else 2 * length / turn * np.sin(turn / 2)
        error = np.sqrt(distance_var) * fresh
        if lateral_var > 0:
            error = error + 1j * np.sqrt(lateral_var) * self.rng.standard_normal(self.count)
        if noise.step_m is None:
            facing, along = self.theta + change / 2, np.exp(1j * turn / 2)
        else:
            facing, along = self.theta + change, np.exp(1j * turn / (2 if length > 0 else 1))
        direction = self.u * along
        scale = 1 + noise.distance_scale_error + self.deviations[2] * noise.distance_scale_std
        self.p_hat += direction * np.exp(1j * facing) * (chord * scale + error)
        self.p += direction * chord
        self.u *= np.exp(1j * turn)
        self.theta += change

    def _heading_errors(self, variance: float) -> Floats:
        law, count = self.noise.heading_law, self.count
        if variance == 0:
            return np.zeros(count)
        if law == "laplace":
            return self.rng.laplace(0.0, np.sqrt(variance / 2), count)
        if law == "uniform":
            return self.rng.uniform(-np.sqrt(3 * variance), np.sqrt(3 * variance), count)
        if law == "von_mises":
            return self.rng.vonmises(0.0, 1 / variance, count)
        return self.rng.normal(0.0, np.sqrt(variance), count)

    def _fix(self, fix: Fix) -> None:
        seen = self.rng.random(self.count) < fix.detection_probability
        if fix.position_cov is not None:
            x = self.rng.multivariate_normal(np.zeros(2), fix.position_cov, self.count)
            self.p_hat = np.where(seen, self.p + x[:, 0] + 1j * x[:, 1], self.p_hat)
        if fix.heading_std is not None:
            self.theta = np.where(seen, self.rng.normal(0.0, fix.heading_std, self.count), self.theta)
