"""Beacons: things in the world that give a robot an absolute fix while it is in range: what they measure and where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from driftplan.arrays import Floats, not_negative, number, positive


@dataclass(frozen=True, slots=True, kw_only=True)
class BeaconKind:
    """What a beacon measures, how well, and from how far. Made by `rfid`, `landmark`, `heading`, or in full.

    Parameters
    ----------
    name : str
    range_m : float
        Metres, > 0: a closed disc around the beacon.
    position_std_m : float or None
        Standard deviation of a measured position per axis, metres; None: position is not measured.
    heading_std : float or None
        Standard deviation of a measured heading, rad; None: heading is not measured.
    detection_probability : float
        Probability in (0, 1] that a pass is noticed.
    line_of_sight : bool
        Whether walls block it (when a world is given).
    reading_spacing_m : float
        Readings on a long pass are at most this far apart, metres.
    cost : float
        What one costs, in any unit, > 0.

    Raises
    ------
    ValueError
        For values that are not finite, out of range, or a kind that measures nothing.
    """

    name: str
    range_m: float
    position_std_m: float | None = None
    heading_std: float | None = None
    detection_probability: float = 1.0
    line_of_sight: bool = False
    reading_spacing_m: float = 3.0
    cost: float = 1.0

    def __post_init__(self) -> None:
        for name in ("range_m", "reading_spacing_m", "cost", "detection_probability"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
        for name in ("position_std_m", "heading_std"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, not_negative(name, getattr(self, name)))
        if self.position_std_m is None and self.heading_std is None:
            raise ValueError("expected a kind of beacon with position_std_m, heading_std or both, got neither")
        if self.detection_probability > 1:
            raise ValueError(f"expected detection_probability in (0, 1], got {self.detection_probability!r}")

    @classmethod
    def rfid(
        cls,
        range_m: float,
        position_std_m: float,
        *,
        detection_probability: float = 1.0,
        reading_spacing_m: float = 3.0,
        cost: float = 1.0,
    ) -> BeaconKind:
        """A tag that tells the position and leaves the heading error as it is; walls do not block it.

        Examples
        --------
        >>> BeaconKind.rfid(range_m=1.5, position_std_m=0.1).heading_std is None
        True
        """
        return cls(
            name="rfid",
            range_m=range_m,
            position_std_m=position_std_m,
            detection_probability=detection_probability,
            reading_spacing_m=reading_spacing_m,
            cost=cost,
        )

    @classmethod
    def landmark(
        cls,
        range_m: float,
        position_std_m: float,
        heading_std: float,
        *,
        detection_probability: float = 1.0,
        line_of_sight: bool = True,
        reading_spacing_m: float = 3.0,
        cost: float = 1.0,
    ) -> BeaconKind:
        """A full fix, position and heading (rad): an AprilTag, a reflector set, a docking station."""
        return cls(
            name="landmark",
            range_m=range_m,
            position_std_m=position_std_m,
            heading_std=heading_std,
            detection_probability=detection_probability,
            line_of_sight=line_of_sight,
            reading_spacing_m=reading_spacing_m,
            cost=cost,
        )

    @classmethod
    def heading(
        cls,
        range_m: float,
        heading_std: float,
        *,
        detection_probability: float = 1.0,
        line_of_sight: bool = False,
        reading_spacing_m: float = 3.0,
        cost: float = 1.0,
    ) -> BeaconKind:
        """A heading reference (rad) that leaves the position error: a wall of known direction, a light strip."""
        return cls(
            name="heading",
            range_m=range_m,
            heading_std=heading_std,
            detection_probability=detection_probability,
            line_of_sight=line_of_sight,
            reading_spacing_m=reading_spacing_m,
            cost=cost,
        )


@dataclass(frozen=True, slots=True)
class Beacon:
    """A beacon at x, y (metres, world frame). Beacons without an ``id`` are numbered where an id is needed.

    Examples
    --------
    >>> Beacon(BeaconKind.rfid(range_m=1.5, position_std_m=0.1), x=3.0, y=4.0, id="A7").id
    'A7'
    """

    kind: BeaconKind
    x: float
    y: float
    id: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.kind, BeaconKind):
            raise ValueError(f"expected kind to be a BeaconKind, got {self.kind!r}")
        for name in ("x", "y"):
            object.__setattr__(self, name, number(name, getattr(self, name)))

    @property
    def xy(self) -> Floats:
        """Metres, (2,)."""
        return np.array([self.x, self.y])
