"""PointDrift: the drift at points, and what is asked of it there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, as_covariance, as_plane
from driftplan.model import scores
from driftplan.model.moments import Moments
from driftplan.tables import Tabular, decimals, digits, rows_of


@dataclass(frozen=True, slots=True, eq=False)
class PointDrift(Tabular):
    """Drift e = estimated minus true position at points, over any leading axes (none for a single point).

    Everything is exact to second order under the noise model, except `mean_distance`, `radius` and
    `probability_within`, which treat the error as Gaussian (`driftplan.model.scores` states the error of that).
    A variance much smaller than E|e|² is exact to rounding of that only, about 1e-15 E|e|²: it may fall below zero.

    Attributes
    ----------
    distance : (...), metres driven from the path's start
    moments : Moments, shape (...): true pose and error moments, world frame

    >>> from driftplan import OdometryNoise, predict_drift
    >>> end = predict_drift([(0, 0), (100, 0)], OdometryNoise(distance_var_per_m=0.01)).end
    >>> float(end.rms), end.bias, end.cov.diagonal()
    (1.0, array([0., 0.]), array([1., 0.]))
    """

    distance: Floats
    moments: Moments

    def __repr__(self) -> str:
        """What a person would want to know, not pages of moments."""
        if not self.rms.ndim:
            return f"{type(self).__name__}(distance={float(self.distance):.6g} m, rms={float(self.rms):.4g} m)"
        return f"{type(self).__name__}(shape={self.rms.shape}, greatest rms={np.max(self.rms, initial=0.0):.4g} m)"

    __str__ = words = __repr__

    def to_dicts(self) -> list[dict[str, Any]]:
        """One row per point: where it truly is and all about the drift there, m and rad. ``path`` counts a batch's.

        >>> from driftplan import OdometryNoise, predict_drift
        >>> drift = predict_drift([(0, 0), (9, 0)], OdometryNoise(heading_var_per_m=1e-3))
        >>> drift.to_pandas()["rms_m"].round(3).tolist()
        [0.0, 0.493]
        """
        cov, shape = self.cov, self.rms.shape
        columns = {
            **({"path": np.arange(np.prod(shape[:-1])).repeat(shape[-1])} if len(shape) > 1 else {}),
            "distance_m": self.distance,
            "x_m": self.xy[..., 0],
            "y_m": self.xy[..., 1],
            "rms_m": self.rms,
            "bias_x_m": self.bias[..., 0],
            "bias_y_m": self.bias[..., 1],
            "cov_xx_m2": cov[..., 0, 0],
            "cov_xy_m2": cov[..., 0, 1],
            "cov_yy_m2": cov[..., 1, 1],
            "radius95_m": self.radius(0.95),
            "heading_std_rad": self.heading_std,
        }
        return rows_of(columns)

    def columns(self) -> dict[str, list[str]]:
        """The drift along one path, in at most about twenty rows."""
        if self.rms.ndim != 1:
            return {}
        few = slice(None, None, max(len(self.rms) // 20, 1))
        rms, radius = digits(self.rms[few], self.radius(0.95)[few])
        xy = self.xy[few].T
        places = dict(zip(("distance m", "x m", "y m"), (self.distance[few], *xy), strict=True))
        columns = {name: decimals(values, 2) for name, values in places.items()}
        return {**columns, "rms m": rms, "95 % radius m": radius}

    @property
    def xy(self) -> Floats:
        """True position, metres, world frame, (..., 2)."""
        return as_plane(self.moments.p)

    @property
    def heading(self) -> Floats:
        """True heading on arrival, rad, (...)."""
        return np.asarray(np.angle(self.moments.u))

    @property
    def rms(self) -> Floats:
        """sqrt(E|e|²), metres, (...): the default score."""
        return np.asarray(np.sqrt(np.maximum(self.moments.N.real, 0.0)))

    @property
    def bias(self) -> Floats:
        """E[e], metres, world frame, (..., 2)."""
        return as_plane(self.moments.e1)

    @property
    def bias_norm(self) -> Floats:
        """|E[e]|, metres, (...). Reported for comparison only: a detour can cancel it while the error grows."""
        return np.abs(self.moments.e1)

    @property
    def cov(self) -> Floats:
        """Covariance of e, m², world frame, (..., 2, 2)."""
        return as_covariance(self.moments.e1, self.moments.N, self.moments.e2)

    @property
    def cov_body(self) -> Floats:
        """Covariance of e, m², in the robot's true frame (x forward, y left), (..., 2, 2)."""
        return as_covariance(self.moments.e1, self.moments.N, self.moments.e2, np.conj(self.moments.u))

    @property
    def trace(self) -> Floats:
        """Trace of the covariance, m², (...)."""
        return np.asarray(np.maximum(self.moments.N.real - np.abs(self.moments.e1) ** 2, 0.0))

    @property
    def largest_eigenvalue(self) -> Floats:
        """Largest eigenvalue of the covariance, m², (...): variance in the worst direction."""
        skew = self.moments.e2 - self.moments.e1**2
        return np.asarray(0.5 * (self.trace + np.abs(skew)))

    @property
    def heading_std(self) -> Floats:
        """Circular standard deviation sqrt(-2 ln|E exp(jθ)|) of the heading error θ, rad, (...)."""
        d1 = self.moments.d1
        coherence_m1 = 2 * d1.real + np.abs(d1) ** 2  # |E r|² - 1, without cancellation
        with np.errstate(divide="ignore"):
            return np.asarray(np.sqrt(np.maximum(-np.log1p(np.maximum(coherence_m1, -1.0)), 0.0)))

    @property
    def mean_distance(self) -> Floats:
        """E|e|, metres, (...), Gaussian approximation."""
        return scores.mean_distance(self.bias, self.cov)

    def radius(self, confidence: float = 0.95) -> Floats:
        """Radius about the true position that holds the estimate with the given confidence, metres, (...)."""
        return scores.radius_at(confidence, self.bias, self.cov)

    def probability_within(self, radius_m: ArrayLike) -> Floats:
        """Probability that the estimate is within ``radius_m`` metres of the true position, (...)."""
        return scores.probability_within(radius_m, self.bias, self.cov)
