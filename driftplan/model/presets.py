"""Noise of real odometry, published or fitted to published recordings: to start from, until a log of yours is fitted.

Odometry differs more between two floors than between two papers. A preset says what somebody measured or assumed, for
which robot, and where that was published; nothing here is a recommendation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from driftplan.model.noise import OdometryNoise


@dataclass(frozen=True, slots=True, kw_only=True)
class Preset:
    """A published noise.

    Attributes
    ----------
    noise : OdometryNoise
    robot : what it was stated for
    source : where
    caution : what to know before using it
    lengths_m : segments over which it was measured, shortest and longest; None where the source says nothing
    intervals : mapping of str to (float, float): 95 % intervals of the rates, where they were fitted

    >>> PRESETS["visual_odometry_indoor"].noise.step_m
    0.064
    """

    noise: OdometryNoise
    robot: str
    source: str
    caution: str
    lengths_m: tuple[float, float] | None = None
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def _from_polar_errors(
    *, step_m: float, heading_scale: float, direction_var: float, distance_var: float, heading_mean: float = 0.0
) -> OdometryNoise:
    """Exact second moments of a step whose measured length and direction err on their own, both Laplace or Gaussian.

    With the direction error φ of Laplace law, E cos kφ = 1/(1 + k² var/2); the measured step
    (d + d̃)(cos φ, sin φ) falls short of d on average and scatters along and across.
    """
    c1, c2 = 1 / (1 + direction_var / 2), 1 / (1 + 2 * direction_var)
    square = step_m**2 + distance_var
    return OdometryNoise(
        heading_var_per_step=2 * heading_scale**2,
        distance_var_per_step=square * (1 + c2) / 2 - (step_m * c1) ** 2,
        lateral_var_per_step=square * (1 - c2) / 2,
        step_m=step_m,
        heading_law="laplace",
        heading_bias_per_m=heading_mean / step_m,
        distance_scale_error=c1 - 1,
    )


def _preset(*, polar: Any = None, rates: Any = None, steps: Any = None, **words: Any) -> Preset:
    """What `presets.yaml` says of one."""
    if polar:
        return Preset(noise=_from_polar_errors(**polar), **words)
    if steps:
        return Preset(noise=OdometryNoise.per_step(**steps), **words)
    intervals = {name: (low, high) for name, (_, low, high) in rates.items()}
    noise = OdometryNoise(**{name: rate for name, (rate, _, _) in rates.items()})
    return Preset(noise=noise, intervals=intervals, **{**words, "lengths_m": tuple(words["lengths_m"])})


_FILE = Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8")
PRESETS: Mapping[str, Preset] = MappingProxyType(
    {name: _preset(**said) for name, said in yaml.safe_load(_FILE).items()}
)
