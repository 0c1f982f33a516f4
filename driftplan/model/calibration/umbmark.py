"""UMBmark: systematic odometry errors from squares driven both ways round.

Wheels of unequal size bend the sides the same way in both directions, a wrong wheelbase makes the corners too wide or
too narrow; the two directions tell them apart. (J. Borenstein, L. Feng, Measurement and correction of systematic
odometry errors in mobile robots, IEEE Transactions on Robotics and Automation 12 (1996) 869-880.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, as_plane, finite, positive
from driftplan.model.noise import OdometryNoise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Umbmark:
    """Outcome of the test; made by `umbmark`.

    Attributes
    ----------
    side_m : float
    centre_clockwise, centre_counterclockwise : (2,), mean return errors, metres
    worst_systematic_m : distance of the farther of the two from zero: the paper's figure of merit E_max,syst
    alpha, beta : error of each corner and bend of each side, rad, by the paper's first-order formulas
    noise : the systematic errors, from both coordinates and without approximation: `heading_bias_per_rad` and
        `heading_bias_per_m`. A square cannot show errors of scale.
    """

    side_m: float
    centre_clockwise: Floats
    centre_counterclockwise: Floats
    worst_systematic_m: float
    alpha: float
    beta: float
    noise: OdometryNoise

    @property
    def wheelbase_ratio(self) -> float:
        """Actual over nominal wheelbase, the paper's E_b."""
        return 1 + self.noise.heading_bias_per_rad

    def wheel_diameter_ratio(self, wheelbase_m: float) -> float:
        """Diameter of the right wheel over that of the left, the paper's E_d, for a robot with this wheelbase."""
        half = 0.5 * positive("wheelbase_m", wheelbase_m)
        curvature = -self.noise.heading_bias_per_m / self.wheelbase_ratio  # of sides the odometry takes for straight
        return (1 + half * curvature) / (1 - half * curvature)


def umbmark(clockwise: ArrayLike, counterclockwise: ArrayLike, *, side_m: float = 4.0) -> Umbmark:
    """Systematic errors from squares that the robot drives by its odometry, both ways round, always from the same pose.

    Parameters
    ----------
    clockwise, counterclockwise : (n, 2), measured minus reported position on return, metres, x along the first side and
        y to its left, a row per run
    side_m : side of the square, metres, as the odometry counts it

    Raises ValueError for arguments of the wrong shape, and errors larger than the square.

    >>> result = umbmark([(-0.21, -0.19), (-0.19, -0.21)], [(-0.05, -0.04), (-0.03, -0.04)], side_m=4.0)
    >>> round(result.alpha, 4), round(result.beta, 4)
    (0.015, 0.01)
    """
    from scipy.optimize import least_squares

    side = positive("side_m", side_m)
    cw, ccw = _centre("clockwise", clockwise), _centre("counterclockwise", counterclockwise)
    if max(np.abs(cw).max(), np.abs(ccw).max()) > side:
        raise ValueError(f"expected return errors smaller than the square's side of {side:g} m, got {cw} and {ccw}")
    alpha, beta = -(cw[0] + ccw[0]) / (4 * side), -(cw[0] - ccw[0]) / (4 * side)  # first order, from x alone

    def misfit(angles: Floats) -> Floats:
        corner, bend = angles
        return np.concatenate([_return(side, -1, corner, bend) - cw, _return(side, 1, corner, bend) - ccw])

    corner, bend = least_squares(misfit, [alpha, beta], method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    per_rad = float(corner / (np.pi / 2 - corner))
    return Umbmark(
        side_m=side,
        centre_clockwise=cw,
        centre_counterclockwise=ccw,
        worst_systematic_m=float(max(np.hypot(*cw), np.hypot(*ccw))),
        alpha=float(alpha),
        beta=float(beta),
        # sides are reported straight: their true bend, measured (1 + per_rad) times too large, cancels the bias
        noise=OdometryNoise(heading_bias_per_rad=per_rad, heading_bias_per_m=float(-(1 + per_rad) * bend / side)),
    )


def _return(side: float, way: int, corner: float, bend: float) -> Floats:
    """Where a robot is that believes it is back: it turns π/2 - ``corner``, its sides bend left by ``bend`` (rad)."""
    turns = np.arange(4) * (way * (np.pi / 2 - corner) + bend)
    sides = side * np.sinc(bend / (2 * np.pi)) * np.exp(1j * (turns + bend / 2))
    return as_plane(sides.sum())


def _centre(name: str, errors: ArrayLike) -> Floats:
    array = finite(name, errors)
    if array.ndim != 2 or array.shape[1] != 2 or len(array) < 1:
        raise ValueError(f"expected {name} of shape (n, 2), a row per run, got {array.shape}")
    return np.asarray(array.mean(axis=0))
