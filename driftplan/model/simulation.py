"""Monte Carlo dead reckoning, with resets or a real Kalman filter: the independent oracle for `drift`.

It shares the reading of paths, and no formula.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Complexes, Floats, as_plane, bounded, choice, generator, positive, whole
from driftplan.model.noise import BETWEEN_DRIVES, SYSTEMATIC, Noises, OdometryNoise, noise_of_legs, spread_of, steps_in
from driftplan.model.paths import Runs, read_path
from driftplan.model.readings import Estimator, Fix


def simulate_drift(
    path: Any,
    noise: Noises,
    *,
    runs: int = 1000,
    rng: np.random.Generator | int = 0,
    start_heading: float | ArrayLike | None = None,
    fixes: Sequence[Fix] = (),
    substep_m: float | None = None,
    estimator: Estimator = "reset",
) -> Floats:
    """Position errors at every waypoint of a path in ``runs`` simulated drives.

    Parameters
    ----------
    path, noise, start_heading, fixes : as for `predict_drift`; one path
    runs : number of drives
    rng : numpy.random.Generator or seed
    substep_m : in the continuous model each run is driven in substeps of at most this length (default: 1/400 of the
        path), with half of a substep's heading error before and half after it moves: the error of E|e|² falls with the
        square of the length
    estimator : {"reset", "filter"}
        What the robot does with a fix: ``reset`` replaces what is measured, ``filter`` fuses it in an extended Kalman
        filter, linearised at the robot's own estimate. It also estimates systematic errors that differ from drive to
        drive.

    Returns estimated minus true positions (runs, n, 2), metres, world frame; at a waypoint with a fix: after it.

    >>> errors = simulate_drift([(0, 0), (10, 0)], OdometryNoise(distance_var_per_m=0.01), runs=4000, rng=1)
    >>> errors.shape, round(float(errors[:, -1, 0].std()), 2)  # sqrt(0.01 * 10) = 0.316
    ((4000, 2, 2), 0.32)
    """
    runs = whole("runs", runs, least=1)
    if substep_m is not None:
        substep_m = positive("substep_m", substep_m)
    choice("estimator", estimator, Estimator)
    legs = read_path(path, start_heading)
    if legs.lengths.ndim != 1:
        raise ValueError(f"expected one path, got a batch of shape {legs.lengths.shape[:-1]}: simulate one by one")
    bounded("errors to simulate", runs * (len(legs.lengths) + 1), 3e8, "use fewer runs")
    bounded("substeps", float(legs.lengths.sum()) / (substep_m or np.inf), 1e7, "use a larger substep_m")
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
    drives = _FusingDrives if estimator == "filter" else _Drives
    return drives(of_leg, runs, generator(rng), legs, substep_m).errors(due)[:, waypoints]


class _Variances(NamedTuple):
    """Of one move's errors: rad², m², m²."""

    heading: float
    distance: float
    lateral: float


class _Drives:
    """Many drives at once: heading error and estimated position of each, beside the one true pose."""

    def __init__(
        self, noises: list[OdometryNoise], count: int, rng: np.random.Generator, legs: Runs, substep_m: float | None
    ) -> None:
        self.noises, self.rng, self.legs, self.count = noises, rng, legs, count
        self.learnt: dict[str, Floats] = {}  # what the robot has found of its systematic errors
        varies = any(noise.varies_between_drives for noise in noises)
        self.deviations = dict(zip(SYSTEMATIC, rng.standard_normal((3, count)), strict=True)) if varies else {}
        self.substep_m = substep_m or max(float(legs.lengths.sum()), 1e-300) / 400
        self.theta = np.zeros(count)  # heading error
        self.p_hat = np.full(count, complex(legs.start))
        self.p = complex(legs.start)
        self.u = complex(np.exp(1j * legs.heading))

    def errors(self, due: dict[int, list[Fix]]) -> Floats:
        out = np.empty((self.count, len(self.legs.lengths) + 1, 2))
        for border in range(len(self.legs.lengths) + 1):
            if border > 0:
                k = border - 1
                self.noise = self.noises[k]
                self._leg(*(float(x[k]) for x in (self.legs.turns, self.legs.lengths, self.legs.curvatures)))
            here = due.get(border, ())
            for fix in sorted(here, key=lambda fix: fix.anchor is not None) if border == 0 else here:
                (self._fix if border > 0 or fix.anchor is not None else self._start)(fix)
            out[:, border] = as_plane(self.p_hat - self.p)
        return out

    def _leg(self, turn: float, length: float, curvature: float) -> None:
        """A turn on the spot, in pieces if its distance errors point where the robot then faces, and a run."""
        swings = self.noise.step_m is None and self.noise.distance_var_per_rad > 0
        self._drive(turn, 0.0, int(np.ceil(abs(turn) / 0.02)) if swings else 1)
        step_m = self.substep_m if self.noise.step_m is None else self.noise.step_m
        self._drive(curvature * length, length, int(steps_in(length, step_m)))

    def _drive(self, turn: float, length: float, pieces: int) -> None:
        if turn == length == 0:
            return
        noise, turn, length = self.noise, turn / pieces, length / pieces
        per_step = float(noise.step_m is not None and length > 0)
        variances = _Variances(
            noise.heading_var_per_step * per_step
            + noise.heading_var_per_m * length
            + noise.heading_var_per_rad * abs(turn),
            noise.distance_var_per_step * per_step
            + noise.distance_var_per_m * length
            + noise.distance_var_per_rad * abs(turn),
            noise.lateral_var_per_step * per_step + noise.lateral_var_per_m * length,
        )
        for _ in range(pieces):
            self._move(turn, length, variances)

    def _move(self, turn: float, length: float, variances: _Variances) -> None:
        """One true arc and its estimates: all of a step's heading error first (step model), or half of it."""
        noise = self.noise
        random_part = self._heading_errors(variances.heading)
        change = random_part + self._bias("heading_bias_per_m") * length + self._bias("heading_bias_per_rad") * turn
        fresh = self.rng.standard_normal(self.count)
        if noise.heading_distance_corr and variances.heading > 0:
            rho = noise.heading_distance_corr
            fresh = rho * random_part / np.sqrt(variances.heading) + np.sqrt(1 - rho * rho) * fresh
        chord = length if turn == 0 else 2 * length / turn * np.sin(turn / 2)
        error = np.sqrt(variances.distance) * fresh
        if variances.lateral > 0:
            error = error + 1j * np.sqrt(variances.lateral) * self.rng.standard_normal(self.count)
        if noise.step_m is None:
            facing, along = self.theta + change / 2, np.exp(1j * turn / 2)
        else:
            facing, along = self.theta + change, np.exp(1j * turn / (2 if length > 0 else 1))
        direction = self.u * along
        estimated_direction = direction * np.exp(1j * facing)
        estimate = estimated_direction * (chord * (1 + self._bias("distance_scale_error")) + error)
        self.p_hat += estimate
        self.p += direction * chord
        self.u *= np.exp(1j * turn)
        self.theta += change
        self._moved(turn, length, estimate, estimated_direction, variances)

    def _bias(self, name: str) -> Any:
        """A systematic error as far as the robot does not correct it: one number, or one per drive."""
        known = getattr(self.noise, name)
        drawn = self.deviations[name] * getattr(self.noise, BETWEEN_DRIVES[name]) if self.deviations else 0.0
        return known + drawn - self.learnt.get(name, 0.0)

    def _moved(self, turn: float, length: float, estimate: Complexes, facing: Complexes, variances: _Variances) -> None:
        """What else changes with a move: nothing, for a robot that resets."""

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

    def _start(self, fix: Fix) -> None:
        self._fix(fix)

    def _fix(self, fix: Fix) -> None:
        if fix.anchor is not None:
            raise ValueError("a range or a bearing cannot replace anything: expected estimator='filter'")
        seen = self.rng.random(self.count) < fix.detection_probability
        if fix.position_cov is not None:
            x = self.rng.multivariate_normal(np.zeros(2), fix.position_cov, self.count)
            self.p_hat = np.where(seen, self.p + x[:, 0] + 1j * x[:, 1], self.p_hat)
        if fix.heading_std is not None:
            self.theta = np.where(seen, self.rng.normal(0.0, fix.heading_std, self.count), self.theta)


class _FusingDrives(_Drives):
    """Drives of robots with an extended Kalman filter, each with its own covariance, Jacobians and gains.

    Everything is linearised where the robot believes itself to be, from what its odometry reported: the true pose
    enters through measurements only. It knows the noise's variances, not systematic errors; a spread it estimates.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        _, self.spread = spread_of(self.noises)
        self.learnt = {name: np.zeros(self.count) for name in self.spread.names}
        self.size = 3 + len(self.spread.names)
        self.P = np.zeros((self.count, self.size, self.size))
        self.P[:, range(3, self.size), range(3, self.size)] = self.spread.variances

    def _moved(self, turn: float, length: float, estimate: Complexes, facing: Complexes, variances: _Variances) -> None:
        """P ← F P Fᵀ + G Q Gᵀ: ``estimate`` is the displacement the robot believes in, ``facing`` its direction."""
        share = 0.5 if self.noise.step_m is None else 1.0  # of the step's heading error that turns the step itself
        swung = as_plane(1j * estimate)
        F = np.tile(np.eye(self.size), (self.count, 1, 1))
        F[:, :2, 2] = swung
        for k, name in enumerate(self.spread.names, start=3):  # what is learnt is taken off what odometry reports
            if name == "distance_scale_error":
                F[:, :2, k] = -as_plane(estimate)
            else:
                heading = length if name == "heading_bias_per_m" else turn
                F[:, 2, k], F[:, :2, k] = -heading, -share * heading * swung
        G = np.zeros((self.count, self.size, 3))
        G[:, 0, 0], G[:, 1, 0] = facing.real, facing.imag
        G[:, 0, 1], G[:, 1, 1] = -facing.imag, facing.real
        G[:, :2, 2], G[:, 2, 2] = share * swung, 1.0
        Q = np.diag([variances.distance, variances.lateral, variances.heading])
        Q[0, 2] = Q[2, 0] = self.noise.heading_distance_corr * np.sqrt(variances.distance * variances.heading)
        self.P = F @ self.P @ F.transpose(0, 2, 1) + G @ Q @ G.transpose(0, 2, 1)

    def _start(self, fix: Fix) -> None:
        """A fix at the start says how well the start is known."""
        super()._fix(fix)
        if fix.position_cov is not None:
            self.P[:, :2, :2] = fix.position_cov
        if fix.heading_std is not None:
            self.P[:, 2, 2] = fix.heading_std**2

    def _fix(self, fix: Fix) -> None:
        innovation, H, R = self._measured(fix)
        HP = H @ self.P
        gain = np.swapaxes(np.linalg.pinv(HP @ np.swapaxes(H, 1, 2) + R, hermitian=True) @ HP, 1, 2)
        seen = self.rng.random(self.count) < fix.detection_probability
        gain = np.where(seen[:, None, None], gain, 0.0)
        step = np.squeeze(gain @ innovation[..., None], axis=-1)
        self.p_hat = self.p_hat + step[:, 0] + 1j * step[:, 1]
        self.theta = self.theta + step[:, 2]
        for k, name in enumerate(self.spread.names, start=3):
            self.learnt[name] = self.learnt[name] + step[:, k]
        rest = np.eye(self.size) - gain @ H
        self.P = rest @ self.P @ np.swapaxes(rest, 1, 2) + gain @ R @ np.swapaxes(gain, 1, 2)

    def _measured(self, fix: Fix) -> tuple[Floats, Floats, Floats]:
        """Innovations (count, k), their Jacobian in the state (count, k, size) and the covariance of the readings."""
        from scipy.linalg import block_diag

        readings: list[tuple[Floats, Floats, Floats]] = []  # how far off, Jacobian, covariance
        if fix.position_cov is not None:
            readings.append((as_plane(self.p - self.p_hat), np.eye(self.size)[None, :2], fix.position_cov))
        if fix.heading_std is not None:
            readings.append((-self.theta[:, None], np.eye(self.size)[None, 2:3], np.array([[fix.heading_std**2]])))
        if fix.anchor is not None:
            seen, believed = (complex(*fix.anchor) - p for p in (self.p, self.p_hat))
            distance = np.abs(believed)[:, None]
            towards = np.zeros((2, self.count, 1, self.size))
            towards[0, :, 0, :2] = as_plane(-believed) / distance
            towards[1, :, 0, :2], towards[1, :, 0, 2] = as_plane(-1j * believed) / distance**2, -1.0
            if fix.range_std_m is not None:
                readings.append((abs(seen) - distance, towards[0], np.array([[fix.range_std_m**2]])))
            if fix.bearing_std is not None:
                misfit = np.angle(seen / believed * np.exp(1j * self.theta))[:, None]
                readings.append((misfit, towards[1], np.array([[fix.bearing_std**2]])))
        off, rows, covs = zip(*readings, strict=True)
        errors = [self.rng.multivariate_normal(np.zeros(len(cov)), cov, self.count) for cov in covs]
        H = np.concatenate([np.broadcast_to(x, (self.count, *x.shape[1:])) for x in rows], axis=1)
        return np.concatenate(off, axis=1) + np.concatenate(errors, axis=1), H, block_diag(*covs)
