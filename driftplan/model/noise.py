"""OdometryNoise: how one metre and one radian of odometry go wrong.

All rates are for the *estimate*: the robot drives a true path, its odometry reports each increment with the errors
described here, and driftplan predicts where the estimate ends up relative to the truth.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import product
from math import prod, radians, tau
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftplan.arrays import choice, not_negative, number, positive, shaped

HeadingLaw = Literal["gaussian", "laplace", "von_mises", "uniform"]

_PER_STEP = ("heading_var_per_step", "distance_var_per_step", "lateral_var_per_step")
_PER_M = ("heading_var_per_m", "distance_var_per_m", "lateral_var_per_m")
_VARIANCES = (*_PER_M, "heading_var_per_rad", "distance_var_per_rad", *_PER_STEP)
SYSTEMATIC = ("heading_bias_per_m", "heading_bias_per_rad", "distance_scale_error")
BETWEEN_DRIVES = {
    "heading_bias_per_m": "heading_bias_std_per_m",
    "heading_bias_per_rad": "heading_bias_std_per_rad",
    "distance_scale_error": "distance_scale_std",
}
_DRIVES_AVERAGED = (5, 3, 3)  # values of each deviation: a mixture's moments are exact to the 9th (5th) power of it


class SystematicSpread(NamedTuple):
    """Standard deviations between drives of an odometry's systematic errors, rad/m, rad/rad and m/m: those that are not
    zero are further states of a filter, which estimates them as it goes."""

    heading_bias_per_m: float = 0.0
    heading_bias_per_rad: float = 0.0
    distance_scale_error: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """The further states, in this order."""
        return tuple(name for name, std in self._asdict().items() if std > 0)

    @property
    def variances(self) -> tuple[float, ...]:
        """Of the further states."""
        return tuple(std**2 for std in self if std > 0)


NO_SPREAD = SystematicSpread()


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryNoise:
    """Error rates of a planar dead reckoner, in SI units. A standing robot does not drift.

    Two models, told apart by ``step_m``:

    * ``step_m=None`` (default): errors are white along the path, so that the heading error is a Brownian motion in
      distance. Consistent under subdivision: cutting a run in two changes nothing.
    * ``step_m=d``: odometry errs once per step of at most ``d`` metres. A run of length L counts
      ``ceil(L/d - 1e-9)`` equal steps, each drawing its heading error first and then moving, as in the literature's
      constant noise per step. *Not* consistent under subdivision below ``d``. A turn on the spot is one draw.

    Parameters
    ----------
    heading_var_per_m : heading variance gained per metre driven, rad²/m
    distance_var_per_m, lateral_var_per_m : variance along, and across, the direction of travel per metre driven, m²/m
    heading_var_per_rad, distance_var_per_rad : heading (rad²/rad) and distance (m²/rad) variance per radian turned, on
        the spot or along an arc
    heading_var_per_step, distance_var_per_step, lateral_var_per_step : per step, rad², m², m². They need ``step_m``.
    step_m : length of a step in metres; None for the continuous model.
    heading_law : {"gaussian", "laplace", "von_mises", "uniform"}
        Distribution of one step's heading error, entering by its exact characteristic function. The von Mises
        concentration is the reciprocal of the step's heading variance, and it takes no ``heading_distance_corr``.
        Laws other than the Gaussian need ``step_m``: a continuous white error is Gaussian.
    heading_distance_corr : correlation, in [-1, 1], of the heading and distance errors of the same step or stretch. In
        the continuous model it acts half before and half after (Stratonovich), the limit of ever finer odometry.
    heading_bias_per_m : systematic heading error per metre, rad/m; positive when the estimate turns left of the truth
    heading_bias_per_rad : systematic relative error of measured turns: the odometry reports
        ``(1 + heading_bias_per_rad) * turn``
    distance_scale_error : systematic relative error of measured distances: reported is
        ``(1 + distance_scale_error) * distance``
    heading_bias_std_per_m, heading_bias_std_per_rad, distance_scale_std : how much these systematic errors differ from
        one drive to the next (another day, other tyres, another load): standard deviations about the values above,
        Gaussian and constant during a drive. Predictions average over drives; routes and layouts are searched for with
        the values above, and scored with the average; a filter's routes are searched for with what it knows of them.

    Raises ValueError if a rate is negative, not finite, or needs a ``step_m`` that is not given.

    >>> OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=4e-4).heading_std_after(100.0)
    0.1
    """

    heading_var_per_m: float = 0.0
    distance_var_per_m: float = 0.0
    lateral_var_per_m: float = 0.0
    heading_var_per_rad: float = 0.0
    distance_var_per_rad: float = 0.0
    heading_var_per_step: float = 0.0
    distance_var_per_step: float = 0.0
    lateral_var_per_step: float = 0.0
    step_m: float | None = None
    heading_law: HeadingLaw = "gaussian"
    heading_distance_corr: float = 0.0
    heading_bias_per_m: float = 0.0
    heading_bias_per_rad: float = 0.0
    distance_scale_error: float = 0.0
    heading_bias_std_per_m: float = 0.0
    heading_bias_std_per_rad: float = 0.0
    distance_scale_std: float = 0.0

    def __post_init__(self) -> None:
        for name in (*SYSTEMATIC, "heading_distance_corr"):
            object.__setattr__(self, name, number(name, getattr(self, name)))
        for name in (*_VARIANCES, *BETWEEN_DRIVES.values()):
            object.__setattr__(self, name, not_negative(name, getattr(self, name)))
        if not -1 <= self.heading_distance_corr <= 1:
            raise ValueError(f"expected heading_distance_corr in [-1, 1], got {self.heading_distance_corr!r}")
        if self.distance_scale_error <= -1:
            raise ValueError(f"expected distance_scale_error > -1, got {self.distance_scale_error!r}")
        choice("heading_law", self.heading_law, HeadingLaw)
        if self.heading_law == "von_mises" and self.heading_distance_corr != 0:
            raise ValueError(
                "heading_distance_corr is not defined for heading_law='von_mises': use 'gaussian', got both"
            )
        if self.step_m is not None:
            object.__setattr__(self, "step_m", positive("step_m", self.step_m))
            return
        for name in _PER_STEP:
            if getattr(self, name) > 0:
                raise ValueError(f"{name}={getattr(self, name)!r} needs step_m, the length of a step in metres")
        if self.heading_law != "gaussian":
            raise ValueError(
                f"heading_law={self.heading_law!r} needs step_m: without steps the heading error is the sum of "
                "infinitely many increments, which is Gaussian"
            )

    @classmethod
    def from_std(
        cls, *, heading_deg: float, distance_m: float, after_m: float, heading_deg_per_full_turn: float = 0.0
    ) -> OdometryNoise:
        """Continuous noise from what people can measure: the spread of repeated straight drives.

        Parameters
        ----------
        heading_deg : standard deviation of the heading error, in degrees, after ``after_m`` metres
        distance_m : standard deviation of the distance error, in metres, after ``after_m`` metres
        after_m : length of the drives, in metres
        heading_deg_per_full_turn : the same in degrees after turning once around (360°) on the spot

        >>> noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
        >>> round(noise.heading_var_per_m, 9), round(noise.distance_var_per_m, 9)
        (3.0462e-05, 0.00025)
        """
        after_m = positive("after_m", after_m)
        heading, distance = not_negative("heading_deg", heading_deg), not_negative("distance_m", distance_m)
        turn = not_negative("heading_deg_per_full_turn", heading_deg_per_full_turn)
        return cls(
            heading_var_per_m=radians(heading) ** 2 / after_m,
            distance_var_per_m=distance**2 / after_m,
            heading_var_per_rad=radians(turn) ** 2 / tau,
        )

    @classmethod
    def per_step(
        cls,
        *,
        heading_std: float,
        distance_std: float,
        step_m: float,
        lateral_std: float = 0.0,
        heading_law: HeadingLaw = "gaussian",
        heading_distance_corr: float = 0.0,
    ) -> OdometryNoise:
        """Constant noise per step (rad, m), the model of the published formulas.

        >>> round(OdometryNoise.per_step(heading_std=0.1, distance_std=0.1, step_m=1.0).heading_std_after(25.0), 9)
        0.5
        """
        spreads = {"heading_std": heading_std, "distance_std": distance_std, "lateral_std": lateral_std}
        heading, distance, lateral = (not_negative(name, value) for name, value in spreads.items())
        return cls(
            heading_var_per_step=heading**2,
            distance_var_per_step=distance**2,
            lateral_var_per_step=lateral**2,
            step_m=step_m,
            heading_law=heading_law,
            heading_distance_corr=heading_distance_corr,
        )

    @classmethod
    def from_amcl(
        cls, alpha1: float, alpha2: float, alpha3: float, alpha4: float, *, step_m: float = 0.25, step_rad: float = 0.2
    ) -> OdometryNoise:
        """Rates implied by the differential-drive motion model of ROS amcl, with a warning.

        amcl draws, once per filter update, rotation errors of variance ``alpha1 * turn² + alpha2 * distance²`` (twice:
        before and after moving) and a distance error of variance ``alpha3 * distance² + alpha4 * (turn1² + turn2²)``.
        Such variances depend on how often the filter updates: ``step_m`` and ``step_rad`` are amcl's ``update_min_d``
        and ``update_min_a``. (S. Thrun, W. Burgard, D. Fox, Probabilistic Robotics, 2005, table 5.6; nav2_amcl,
        differential motion model.)

        Always warns (UserWarning): alphas are tuned for enough particles in the filter, and usually overstate physics.
        """
        warnings.warn(
            "amcl's alphas are filter tuning, not physics: expect them to overstate the drift; fit the noise from a "
            "log when you can",
            UserWarning,
            stacklevel=2,
        )
        alphas = {"alpha1": alpha1, "alpha2": alpha2, "alpha3": alpha3, "alpha4": alpha4}
        a1, a2, a3, a4 = (not_negative(name, value) for name, value in alphas.items())
        step_m, step_rad = positive("step_m", step_m), positive("step_rad", step_rad)
        return cls(
            heading_var_per_m=2 * a2 * step_m,
            distance_var_per_m=a3 * step_m,
            heading_var_per_rad=a1 * step_rad,
            distance_var_per_rad=a4 * step_rad,
        )

    def scaled(self, std_factor: float) -> OdometryNoise:
        """The same odometry, ``std_factor`` times as noisy: deviations and systematic errors times the factor.

        >>> OdometryNoise(heading_var_per_m=1e-4).scaled(2.0).heading_var_per_m
        0.0004
        """
        factor = not_negative("std_factor", std_factor)
        changed = {name: getattr(self, name) * factor**2 for name in _VARIANCES}
        changed |= {name: getattr(self, name) * factor for name in (*SYSTEMATIC, *BETWEEN_DRIVES.values())}
        return replace(self, **changed)

    def heading_std_after(self, length_m: float, turn_rad: float = 0.0) -> float:
        """Standard deviation of the heading error, in rad, after one straight run and turning ``turn_rad`` in all."""
        length_m, turn_rad = not_negative("length_m", length_m), number("turn_rad", turn_rad)
        variance = self.heading_var_per_m * length_m + self.heading_var_per_rad * abs(turn_rad)
        if self.step_m is not None:
            variance += self.heading_var_per_step * float(steps_in(length_m, self.step_m))
        return float(variance**0.5)

    @property
    def spread(self) -> SystematicSpread:
        """How systematic errors differ from one drive to the next."""
        return SystematicSpread(*(getattr(self, std) for std in BETWEEN_DRIVES.values()))

    @property
    def varies_between_drives(self) -> bool:
        """Whether systematic errors differ from one drive to the next."""
        return any(self.spread)

    def on_drive(self, deviations: Sequence[float]) -> OdometryNoise:
        """The noise on a drive whose three systematic errors (heading per metre and per radian, distance scale) lie so
        many of their standard deviations off; it varies no more.

        >>> OdometryNoise(heading_bias_per_m=0.01, heading_bias_std_per_m=0.02).on_drive((-1, 0, 0))
        OdometryNoise(heading_bias_per_m=-0.01)
        """
        known = (getattr(self, name) for name in SYSTEMATIC)
        off = shaped("deviations", deviations, (len(SYSTEMATIC),))
        shifted = (value + z * std for value, z, std in zip(known, off.tolist(), self.spread, strict=True))
        changed: dict[str, Any] = dict(zip(SYSTEMATIC, shifted, strict=True))
        changed["distance_scale_error"] = max(changed["distance_scale_error"], -0.99)
        changed |= dict.fromkeys(BETWEEN_DRIVES.values(), 0.0)
        return replace(self, **changed)

    def corrected(self) -> OdometryNoise:
        """What is left when known systematic errors are corrected for: random ones, and the spread between drives."""
        none: dict[str, Any] = dict.fromkeys(SYSTEMATIC, 0.0)
        return replace(self, **none)

    @property
    def is_systematic(self) -> bool:
        """Whether any systematic error (bias or scale) is set."""
        return any(getattr(self, name) != 0 for name in SYSTEMATIC)

    @property
    def is_plain(self) -> bool:
        """Whether it is white along the path, without steps, systematic or correlated errors: what the additive cost
        of `driftplan.planning.cost` prices in full, so that its bracket holds."""
        spread = self.is_systematic or self.varies_between_drives
        return self.step_m is None and not spread and self.heading_distance_corr == 0

    @property
    def turns_matter(self) -> bool:
        """Whether a turn on the spot adds any error."""
        return bool(self.heading_var_per_rad or self.distance_var_per_rad or self.heading_bias_per_rad)

    def given(self) -> dict[str, Any]:
        """Only what differs from a perfect odometer, by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}

    def __repr__(self) -> str:
        return f"OdometryNoise({', '.join(f'{name}={value!r}' for name, value in self.given().items())})"


def drives_to_average(noises: Sequence[OdometryNoise]) -> list[tuple[float, tuple[float, ...]]]:
    """Weights and deviations (`OdometryNoise.on_drive`) of a few drives whose average is that over all drives of a
    robot with these noises, on whatever floor; one drive where nothing differs."""
    varies = np.any([noise.spread for noise in noises], axis=0)
    axes = [_normal(count if some else 1) for count, some in zip(_DRIVES_AVERAGED, varies, strict=True)]
    return [(prod(weight for _, weight in drive), tuple(z for z, _ in drive)) for drive in product(*axes)]


@cache
def _normal(count: int) -> list[tuple[float, float]]:
    """A few values of a standard normal variable, and their weights."""
    values, weights = np.polynomial.hermite_e.hermegauss(count)
    return list(zip(values.tolist(), (weights / weights.sum()).tolist(), strict=True))


def spread_of(noises: Sequence[OdometryNoise]) -> tuple[tuple[OdometryNoise, ...], SystematicSpread]:
    """Noises without spread, and the spread that a filter estimates: one for all floors, since it is the robot's."""
    spreads = {noise.spread for noise in noises}
    if len(spreads) > 1:
        raise ValueError("expected noises whose systematic errors differ alike between drives, got several spreads")
    return tuple(noise.on_drive((0, 0, 0)) for noise in noises), spreads.pop()


def check_continuous(noises: Iterable[OdometryNoise]) -> None:
    """Refuse noise per step: the drift then depends on where a path is cut, and "everywhere" has no exact meaning."""
    for noise in noises:
        if noise.step_m is not None:
            rates = {
                name: getattr(noise, f"{name}_per_m") + getattr(noise, f"{name}_per_step") / noise.step_m
                for name in ("heading_var", "distance_var", "lateral_var")
            }
            per_m = ", ".join(f"{name}_per_m={rate:g}" for name, rate in rates.items() if rate)
            raise ValueError(
                "expected noise of the continuous kind, got noise per step (step_m), which depends on how a path is "
                f"cut; use rates per metre, here OdometryNoise({per_m})"
            )


def steps_in(length_m: ArrayLike, step_m: float) -> NDArray[np.float64]:
    """Number of steps that runs of ``length_m`` metres count: ``ceil(L/d - 1e-9)``, any shape."""
    return np.asarray(np.ceil(np.asarray(length_m, dtype=float) / step_m - 1e-9))


def noise_of_legs(noise: Noises, legs: int, legs_per_run: int) -> tuple[tuple[OdometryNoise, ...], NDArray[np.intp]]:
    """The distinct noises of a path, and which of them each leg has."""
    if isinstance(noise, OdometryNoise):
        return (noise,), np.zeros(legs, dtype=np.intp)
    if not (isinstance(noise, Sequence) and all(isinstance(n, OdometryNoise) for n in noise)):
        raise ValueError(f"expected an OdometryNoise or one per run, got {type(noise).__name__}")
    if len(noise) * legs_per_run != legs:
        raise ValueError(f"expected one OdometryNoise per run, {legs // legs_per_run} in all, got {len(noise)}")
    index: dict[OdometryNoise, int] = {}
    of_run = np.array([index.setdefault(n, len(index)) for n in noise], dtype=np.intp)
    return tuple(index), np.repeat(of_run, legs_per_run)


Noises = OdometryNoise | Sequence[OdometryNoise]
