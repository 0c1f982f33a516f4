r"""The additive drift cost: what one motion adds to the expected squared error at the goal, in closed form.

With ``w(s)`` the vector from the path to the goal, heading noise of variance ``q_h`` per metre and position noise of
variance ``q_p`` per metre give

.. math:: J = \int (q_h |w|^2 + q_p)\,ds + \sum_{\text{turns}} (q_t |w|^2 + q_u) |\Delta\theta| \qquad [m^2].

J is additive over motions, the same in both directions, and unchanged when a motion is cut in two, which is what a
planner needs. It brackets the exact expectation: the heading part of ``E|e|^2`` lies between ``bracket(sigma_H)`` times
the heading part of J and that part itself, ``sigma_H`` being the standard deviation of the heading error at the goal;
the position part is exact. (Telescoping the dead-reckoning recursion gives the exact quadratic form in w; the spectrum
of its kernel ``exp(-|t - t'|)`` on an interval is in H. L. Van Trees, Detection, Estimation, and Modulation Theory I,
1968, sec. 3.4.)

What J prices exactly: white heading, distance and lateral noise, along runs and in turns. What it does not:

* Noise per step (``step_m``) enters through its equivalent rate, the variance per step divided by ``step_m``. The true
  step noise depends on how a path is cut into runs, which no additive cost can follow, so J then only ranks and bounds
  nothing.
* Systematic errors (biases, scale) move the whole estimated path, and their effect is not additive in w: left out.
* The correlation of heading and distance errors (``heading_distance_corr``) is left out too.

Finished paths must therefore be compared by `driftplan.model.drift.predict_drift`, which prices all of it.

In three dimensions (last axis 3) noise is isotropic: ``heading_var_per_m`` is the variance of each of the three
components of the rotation error. The component along w moves nothing, the other two do, hence ``2 q_h |w|^2``; and
there are two lateral directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, instance
from driftplan.model.noise import OdometryNoise


@dataclass(frozen=True, slots=True)
class CostRates:
    """The four rates that price a motion, in one place of the world; or arrays of them, one for each motion."""

    heading: float  # mean square of the position error per square metre of lever ``|w|``, per metre driven, rad²/m
    position: float  # variance of the position, all directions summed, per metre driven, m²/m
    turn_heading: float = 0.0  # the same per radian turned, rad²/rad
    turn_position: float = 0.0  # m²/rad

    @classmethod
    def of(cls, noise: OdometryNoise | CostRates, dimensions: int = 2) -> CostRates:
        """Rates of ``noise`` in the plane or, isotropic, in space; noise per step by its equivalent rate.

        >>> CostRates.of(OdometryNoise.per_step(heading_std=0.5, distance_std=0.2, step_m=0.5)).heading
        0.5
        """
        if isinstance(noise, CostRates):
            return noise
        instance("noise", noise, OdometryNoise)
        heading, along, across = noise.heading_var_per_m, noise.distance_var_per_m, noise.lateral_var_per_m
        if noise.step_m is not None:
            heading += noise.heading_var_per_step / noise.step_m
            along += noise.distance_var_per_step / noise.step_m
            across += noise.lateral_var_per_step / noise.step_m
        axes = dimensions - 1  # that swing the goal, and directions that are lateral
        turn_heading, turn_position = axes * noise.heading_var_per_rad, noise.distance_var_per_rad
        return cls(axes * heading, along + axes * across, turn_heading, turn_position)


def edge_cost(a: ArrayLike, b: ArrayLike, goal: ArrayLike, noise: OdometryNoise | CostRates) -> Floats:
    """Cost of straight runs from ``a`` to ``b`` (..., 2|3), in m²: ``(q_h/3)(|w0|² + w0·w1 + |w1|²) L + q_p L``.

    Metres; points broadcast. Never negative, symmetric, additive under cutting. `CostRates` save the conversion in
    loops.

    >>> noise = OdometryNoise(heading_var_per_m=1e-3)
    >>> round(float(edge_cost([0, 0], [10, 0], [10, 0], noise)), 6)        # q L³/3
    0.333333
    """
    w0, w1, step, rates = _levers(a, b, goal, noise)
    length = np.sqrt(_dot(step, step))
    mean_square = (_dot(w0, w0) + _dot(w0, w1) + _dot(w1, w1)) / 3
    return np.asarray((rates.heading * mean_square + rates.position) * length)


def turn_cost(at: ArrayLike, turn_rad: ArrayLike, goal: ArrayLike, noise: OdometryNoise | CostRates) -> Floats:
    """Cost of turning on the spot by ``turn_rad`` (either sense) at ``at`` (..., 2|3), in m².

    >>> noise = OdometryNoise(heading_var_per_rad=1e-3)
    >>> round(float(turn_cost([0, 0], -2.0, [10, 0], noise)), 6)
    0.2
    """
    w, _, _, rates = _levers(at, at, goal, noise)
    turn = np.abs(np.asarray(turn_rad, dtype=float))
    if not np.isfinite(turn).all():
        raise ValueError("expected turn_rad finite")
    return np.asarray((rates.turn_heading * _dot(w, w) + rates.turn_position) * turn)


def geodesic_cost(a: ArrayLike, b: ArrayLike, goal: ArrayLike, noise: OdometryNoise | CostRates) -> Floats:
    """Lower bound in m² of the cost of any path from ``a`` to ``b``: no obstacles, no turn costs.

    ``|w|²|dw| = |d(w³/3)|``: w -> w³/3 makes the heading metric flat (a cone of angle 6π). With φ the angle between the
    two levers its geodesics have length ``|w0³ - w1³|/3`` for φ < π/3 and run through the goal beyond. Adding ``q_p``
    times the straight distance gives a sum of two metrics, each at most its part of the true cost: admissible and
    consistent, symmetric, zero only for a = b. To the goal itself it is ``q_h r³/3 + q_p r``, which the straight run
    attains. Geodesics in space stay in the plane of the goal and the two points, so the formula is the same.

    >>> noise = OdometryNoise(heading_var_per_m=1.0)
    >>> round(float(geodesic_cost([1, 0], [0, 1], [0, 0], noise)), 9)      # shorter through the goal
    0.666666667
    """
    w0, w1, step, rates = _levers(a, b, goal, noise)
    r0, r1 = np.linalg.norm(w0, axis=-1), np.linalg.norm(w1, axis=-1)
    length = np.linalg.norm(step, axis=-1)
    total = r0 + r1
    # Differences of nearly equal levers are formed from the step itself, so that short edges keep their digits.
    radial = _dot(step, w0 + w1) / np.where(total > 0, total, 1.0)  # r0 - r1
    in_plane = step[..., 0] * w0[..., 1] - step[..., 1] * w0[..., 0]
    across = np.abs(in_plane) if w0.shape[-1] == 2 else np.linalg.norm(np.cross(step, w0), axis=-1)
    angle = np.arctan2(across, _dot(w0, w1))
    chord = np.hypot(radial * (r0**2 + r0 * r1 + r1**2), 2 * (r0 * r1) ** 1.5 * np.sin(1.5 * angle))
    metric = np.where(angle < np.pi / 3, chord, r0**3 + r1**3) / 3
    return np.asarray(rates.heading * metric + rates.position * length)


def bracket(heading_std_end: ArrayLike) -> Floats:
    r"""The factor :math:`\Lambda` with ``Λ J <= E|e|² <= J`` for the heading part of the cost.

    ``cos² x`` where ``x tan x = heading_std_end²/4`` and ``0 <= x < π/2``, between ``exp(-std²/4)`` and 1;
    ``heading_std_end`` (...) is the standard deviation in rad of the heading error at the path's end (in space, the
    root of twice the variance per axis). The path of least J has at most 1/Λ times the least possible expected squared
    error, Λ taken at the heading error of the truly best path.

    >>> bracket([0.0, 0.3, 1.0]).round(5)
    array([1.     , 0.97783, 0.78668])
    """
    std = np.asarray(heading_std_end, dtype=float)
    if not np.isfinite(std).all() or (std < 0).any():
        raise ValueError(f"expected heading_std_end >= 0 and finite, got {heading_std_end!r}")
    load = std**2 / 4
    x = np.sqrt(load / (1 + load * (4 / np.pi**2)))  # right where the load is small, and where it is large
    for _ in range(6):  # Newton's method on x sin x - load cos x, which increases from 0 to π/2
        rise = (1 + load) * np.sin(x) + x * np.cos(x)
        x = np.clip(x - (x * np.sin(x) - load * np.cos(x)) / np.maximum(rise, 1e-300), 0.0, np.pi / 2)
    return np.asarray(np.cos(x) ** 2)


def _levers(
    a: ArrayLike, b: ArrayLike, goal: ArrayLike, noise: OdometryNoise | CostRates
) -> tuple[Floats, Floats, Floats, CostRates]:
    """The vectors from ``a`` and ``b`` to the goal, the step ``b - a``, and the rates of the space they live in."""
    points = [np.asarray(value, dtype=float) for value in (a, b, goal)]
    for name, point in zip(("a", "b", "goal"), points, strict=True):
        if point.ndim < 1 or point.shape[-1] not in (2, 3) or point.shape[-1] != points[0].shape[-1]:
            raise ValueError(f"expected points (..., 2), or all (..., 3); {name} has shape {point.shape}")
        if not np.isfinite(point).all():
            raise ValueError(f"expected finite coordinates, got {name} with NaN or infinity")
    a, b, end = points  # the step is not formed from the levers, which would lose the digits of short steps
    return end - a, end - b, b - a, CostRates.of(noise, a.shape[-1])


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("...i,...i", a, b))
