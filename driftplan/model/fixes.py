"""Fixes: absolute measurements on the way, and what they do to the error moments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from driftplan.arrays import Floats, covariance, not_negative, number
from driftplan.model.heading_laws import law_moments
from driftplan.model.moments import Moments


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fix:
    """An absolute measurement at the distance ``s_m`` along a path.

    The measured quantity's error is replaced by the measurement's, independent of all before: a full fix replaces
    position and heading error, a position fix (RFID) leaves the heading error, a heading fix the position error.
    Nothing is fused: a fix less accurate than the estimate makes it worse, and a filter that used the correlation of
    position and heading error would also gain heading from a position fix. In the step model (``step_m``) a fix ends a
    step: the run it lies in counts its steps anew on either side, whether or not the fix is detected.

    Attributes
    ----------
    s_m : float
        Where along the path, metres from its start.
    position_cov : (2, 2) array or None
        Covariance of the measured position, m², world frame; None: position not measured.
    heading_std : float or None
        Standard deviation of the measured heading, rad (Gaussian); None: heading not measured.
    detection_probability : float
        Probability that the measurement happens at all; otherwise the drift goes on as if there were no fix.

    Raises
    ------
    ValueError
        For negative or infinite values, a covariance that is none, a probability outside [0, 1].
    """

    s_m: float
    position_cov: Floats | None = None
    heading_std: float | None = None
    detection_probability: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "s_m", not_negative("s_m", self.s_m))
        if self.position_cov is None and self.heading_std is None:
            raise ValueError("expected a fix to measure position_cov, heading_std or both, got neither")
        if self.heading_std is not None:
            object.__setattr__(self, "heading_std", not_negative("heading_std", self.heading_std))
        if not 0 <= number("detection_probability", self.detection_probability) <= 1:
            raise ValueError(f"expected detection_probability in [0, 1], got {self.detection_probability!r}")
        if self.position_cov is not None:
            cov = covariance("position_cov", self.position_cov).copy()
            cov.setflags(write=False)
            object.__setattr__(self, "position_cov", cov)

    @classmethod
    def full(cls, s_m: float, *, position_std_m: float, heading_std: float, detection_probability: float = 1.0) -> Fix:
        """Position and heading: an AprilTag, a reflector set, a docking station. ``position_std_m`` is per axis.

        Examples
        --------
        >>> Fix.full(10.0, position_std_m=0.1, heading_std=0.02).heading_std
        0.02
        """
        return cls(
            s_m=s_m,
            position_cov=_isotropic(position_std_m),
            heading_std=heading_std,
            detection_probability=detection_probability,
        )

    @classmethod
    def position(cls, s_m: float, *, position_std_m: float, detection_probability: float = 1.0) -> Fix:
        """Position only: an RFID tag. ``position_std_m`` is per axis."""
        return cls(s_m=s_m, position_cov=_isotropic(position_std_m), detection_probability=detection_probability)

    @classmethod
    def heading(cls, s_m: float, *, heading_std: float, detection_probability: float = 1.0) -> Fix:
        """Heading only: a compass, a wall of known direction."""
        return cls(s_m=s_m, heading_std=heading_std, detection_probability=detection_probability)


def apply_fix(before: Moments, fix: Fix) -> Moments:
    """Error moments (world frame) just after ``fix``, given those just before it; exact.

    A detection probability p mixes the two outcomes, and moments of a mixture are mixtures of moments.
    """
    zero = np.zeros(before.shape)
    d1, d2, D, e1, N, e2 = before.d1, before.d2, before.D, before.e1, before.N, before.e2
    if fix.heading_std is not None:
        law = law_moments("gaussian", np.asarray(fix.heading_std**2))
        d1, d2, D = zero + law.d1, zero + law.d2, zero - 2 * law.d1
    if fix.position_cov is not None:
        (xx, xy), (_, yy) = fix.position_cov.tolist()
        e1, N, e2 = zero, zero + (xx + yy), zero + complex(xx - yy, 2 * xy)
    # the measured part is fresh, hence independent of the part that stays
    after = Moments(before.u, before.p, d1, d2, D, e1, N, e2, e1 * np.conj(d1), e1 * d1)
    p = fix.detection_probability
    if p == 1:
        return after
    mixed = ((1 - p) * x + p * y for x, y in zip(before.arrays()[2:], after.arrays()[2:], strict=True))
    return Moments(before.u, before.p, *mixed)


def _isotropic(position_std_m: float) -> Floats:
    return not_negative("position_std_m", position_std_m) ** 2 * np.eye(2)
