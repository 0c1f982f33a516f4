"""Noise of real odometry, from the literature or fitted to published recordings, each with its source: to start from,
until a log of your own is fitted.

Odometry differs more between two floors than between two papers. A preset says what somebody measured or assumed, for
which robot, and where that was published; nothing here is a recommendation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import sqrt
from types import MappingProxyType
from typing import Any

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
    lengths_m : segments over which it was measured, from the shortest to the longest; None where the source says
        nothing.
    intervals : mapping of str to (float, float): 95 % intervals of the rates, where they were fitted
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


def _fitted(rates: Mapping[str, tuple[float, float, float]], **words: Any) -> Preset:
    """From every rate with the ends of its 95 % interval."""
    fitted: dict[str, Any] = {name: rate for name, (rate, _, _) in rates.items()}
    intervals = {name: (low, high) for name, (_, low, high) in rates.items()}
    return Preset(noise=OdometryNoise(**fitted), intervals=intervals, **words)


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
        "differential_drive_commanded": _fitted(
            {
                "distance_scale_error": (0.053, 0.027, 0.083),
                "heading_bias_per_m": (0.040, -0.0083, 0.084),
                "heading_bias_per_rad": (0.041, 0.002, 0.091),
                "heading_var_per_m": (0.0, 0.0, 0.018),
                "heading_var_per_rad": (0.0164, 0.0074, 0.025),
                "distance_var_per_m": (0.00155, 0.0, 0.0045),
                "distance_var_per_rad": (0.0049, 0.0019, 0.0080),
                "lateral_var_per_m": (0.0, 0.0, 0.00146),
            },
            robot="iRobot Create on an indoor floor, dead reckoning from commanded speeds; three robots, 149 m",
            source="fit_noise on set 7 of the UTIAS MR.CLAM data (K. Leung, Y. Halpern, T. Barfoot, H. Liu, The UTIAS "
            "multi-robot cooperative localization and mapping dataset, International Journal of Robotics Research 30 "
            "(2011) 969-974)",
            caution="commands, not encoders: wheels that are counted err less. Robots differ: predicted from the other "
            "two, one drifts 1.5 times as much over 7 m and one 0.7 times",
            lengths_m=(0.64, 10.3),
        ),
        "mower_wheels_and_gyro": _fitted(
            {
                "distance_scale_error": (0.0028, 0.001, 0.0050),
                "heading_bias_per_m": (2.3e-5, -5.6e-5, 7.9e-5),
                "heading_bias_per_rad": (-9.7e-4, -0.003, 0.0005),
                "heading_var_per_m": (0.0, 0.0, 7.3e-5),
                "heading_var_per_rad": (0.0, 0.0, 4.8e-5),
                "distance_var_per_m": (0.0, 0.0, 0.0009),
                "distance_var_per_rad": (0.024, 0.0, 0.064),
                "lateral_var_per_m": (0.00197, 0.0, 0.0051),
            },
            robot="robotic lawn mower with wheel encoders and a gyro, outdoors, one drive of 1.9 km",
            source="fit_noise on the Plaza1 set (J. Djugash, B. Hamner, S. Roth, Navigating with ranging radios: five "
            "data sets with ground truth, Journal of Field Robotics 26 (2009) 689-695)",
            caution="most of its error comes in a few slips of up to 1.5 m: the rms holds, regions do not; its gyro is "
            "far better than what most robots have",
            lengths_m=(7.3, 116.0),
        ),
        "visual_inertial_drone": _fitted(
            {
                "distance_scale_error": (-0.011, -0.014, -0.0066),
                "heading_bias_per_m": (1.5e-4, -3e-5, 3.5e-4),
                "heading_bias_per_rad": (-3.3e-4, -7.2e-4, 6e-5),
                "heading_var_per_m": (3.9e-6, 0.0, 7.8e-6),
                "heading_var_per_rad": (0.0, 0.0, 1.3e-5),
                "distance_var_per_m": (9.1e-5, 3.6e-6, 2.13e-4),
                "distance_var_per_rad": (0.0, 0.0, 1.27e-4),
                "lateral_var_per_m": (3.1e-5, 0.0, 1.5e-4),
            },
            robot="drone with visual-inertial odometry in a room of 8 m, its motion in the plane; six runs, 385 m",
            source="fit_noise on six estimates of flight V1_02 of the EuRoC data (M. Burri and others, The EuRoC micro "
            "aerial vehicle datasets, International Journal of Robotics Research 35 (2016) 1157-1163) that come with "
            "rpg_trajectory_evaluation",
            caution="it sees the same room again and again: beyond 4 m its errors hardly grow, and 1.3 cm never do",
            lengths_m=(0.97, 15.5),
        ),
        "textbook_steps": Preset(
            noise=OdometryNoise.per_step(heading_std=0.1, distance_std=0.1, step_m=1.0),
            robot="no robot: 0.1 rad and 0.1 m a step, the values with which the published double sums are illustrated",
            source="trajectory experiments of the unbounded-drift paper (see driftplan.literature)",
            caution=f"lost after a few steps: {sqrt(10) * 0.1:.2f} rad of heading error after ten",
        ),
    }
)
