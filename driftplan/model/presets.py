"""Noise of real odometry from the literature, each with its source: to start from, until a log of your own is fitted.

Odometry differs more between two floors than between two papers. A preset says what somebody measured or assumed, for
which robot, and where that was published; nothing here is a recommendation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from types import MappingProxyType

from .noise import OdometryNoise


@dataclass(frozen=True, slots=True, kw_only=True)
class Preset:
    """A published noise.

    Attributes
    ----------
    noise : OdometryNoise
    robot : str
        What it was stated for.
    source : str
        Where.
    caution : str
        What to know before using it.
    """

    noise: OdometryNoise
    robot: str
    source: str
    caution: str


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


_KNUTH_BAROOAH = (
    "J. Knuth, P. Barooah, Error growth in position estimation from noisy relative pose measurements, "
    "Robotics and Autonomous Systems, 2013"
)

PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "visual_odometry_indoor": Preset(
            noise=_from_polar_errors(step_m=0.064, heading_scale=3.6e-3, direction_var=3.07e-2, distance_var=8.5467e-5),
            robot="wheeled robot with a camera, 6.4 cm between images",
            source=f"{_KNUTH_BAROOAH}, section 4.2: Laplace laws as stated there",
            caution="direction errors of 0.18 rad a step: a camera of its time, without any bundle adjustment",
        ),
        "visual_odometry_indoor_with_drift": Preset(
            noise=_from_polar_errors(
                step_m=0.064, heading_scale=3.6e-3, direction_var=3.07e-2, distance_var=8.5467e-5, heading_mean=6.8e-5
            ),
            robot="the same",
            source=f"{_KNUTH_BAROOAH}, section 4.3: with the mean rotation error measured on a circle",
            caution="as above; the bias is that of one camera",
        ),
        "textbook_steps": Preset(
            noise=OdometryNoise.per_step(heading_std=0.1, distance_std=0.1, step_m=1.0),
            robot="no robot: 0.1 rad and 0.1 m a step, the values with which the published double sums are illustrated",
            source="trajectory experiments of the unbounded-drift paper (see driftplan.model.literature)",
            caution=f"lost after a few steps: {sqrt(10) * 0.1:.2f} rad of heading error after ten",
        ),
    }
)
