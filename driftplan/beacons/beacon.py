"""Beacons: things in the world that give a robot an absolute fix while it is in range: what they measure and where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypedDict, Unpack

import numpy as np

from driftplan.arrays import Floats, bounded, instance, not_negative, number, positive

_MAX_READINGS = 10_000  # on one pass


class KindOptions(TypedDict, total=False):
    """What every kind of beacon may be given beside what it measures; see `BeaconKind`."""

    detection_probability: float
    line_of_sight: bool
    reading_spacing_m: float
    cost: float
    std_per_m: float
    view_angle_deg: float
    sensor_view_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BeaconKind:
    """What a beacon measures, how well, and from how far. Made by `rfid`, `landmark`, `heading`, …, or in full.

    Parameters
    ----------
    range_m : metres, > 0: a closed disc around the beacon
    position_std_m : standard deviation of a measured position per axis, metres; None: position is not measured.
    heading_std : standard deviation of a measured heading, rad; None: heading is not measured.
    detection_probability : probability in (0, 1] that a pass is noticed
    line_of_sight : whether walls block it (when a world is given)
    reading_spacing_m : readings on a long pass are at most this far apart, metres
    cost : what one costs, in any unit, > 0
    range_std_m, bearing_std : standard deviation of a measured distance to the beacon (m), and of its measured
        direction in the robot's frame (rad); None: not measured. Only a robot with a filter can use them.
    std_per_m : what ``position_std_m`` and ``range_std_m`` grow by for every metre of distance to the beacon, m/m
    view_angle_deg : the angle from within which it is seen, degrees, centred on where the beacon faces
        (`Beacon.facing_deg`): a tag on a shelf 180 or less. 360: from everywhere.
    sensor_view_deg : the field of view, degrees, centred straight ahead, of the sensor with which the robot reads it

    Raises
    ------
    ValueError : for values that are not finite, out of range, or a kind that measures nothing

    >>> shelf_tag = BeaconKind.rfid(range_m=1.5, position_std_m=0.1, view_angle_deg=180.0, cost=40.0)
    >>> shelf_tag.name, shelf_tag.position_std_m, shelf_tag.heading_std is None
    ('rfid', 0.1, True)
    """

    name: str
    range_m: float
    position_std_m: float | None = None
    heading_std: float | None = None
    detection_probability: float = 1.0
    line_of_sight: bool = False
    reading_spacing_m: float = 3.0
    cost: float = 1.0
    range_std_m: float | None = None
    bearing_std: float | None = None
    std_per_m: float = 0.0
    view_angle_deg: float = 360.0
    sensor_view_deg: float = 360.0

    def __post_init__(self) -> None:
        instance("name of a kind", self.name, str)
        instance("line_of_sight", self.line_of_sight, bool, np.bool_)
        most = {"detection_probability": 1, "view_angle_deg": 360, "sensor_view_deg": 360}
        for name in ("range_m", "reading_spacing_m", "cost", *most):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
        readings = 2 * self.range_m / self.reading_spacing_m
        bounded("readings on one pass", readings, _MAX_READINGS, "use a larger reading_spacing_m")
        measured = ("position_std_m", "heading_std", "range_std_m", "bearing_std")
        for name in (*measured, "std_per_m"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, not_negative(name, getattr(self, name)))
        if all(getattr(self, name) is None for name in measured):
            raise ValueError("expected a kind of beacon with position_std_m, heading_std or both, got neither")
        if self.std_per_m and self.position_std_m is None and self.range_std_m is None:
            raise ValueError("expected std_per_m with a position_std_m or range_std_m that grows by it, got neither")
        for name, bound in most.items():
            if getattr(self, name) > bound:
                raise ValueError(f"expected {name} in (0, {bound}], got {getattr(self, name)!r}")

    @classmethod
    def rfid(cls, range_m: float, position_std_m: float, **more: Unpack[KindOptions]) -> BeaconKind:
        """A tag that tells the position and leaves the heading error as it is; walls do not block it.

        >>> BeaconKind.rfid(range_m=1.5, position_std_m=0.1).heading_std is None
        True
        """
        return cls(name="rfid", range_m=range_m, position_std_m=position_std_m, **more)

    @classmethod
    def landmark(
        cls, range_m: float, position_std_m: float, heading_std: float, **more: Unpack[KindOptions]
    ) -> BeaconKind:
        """A full fix, position and heading (rad), in line of sight unless said otherwise: an AprilTag, a reflector set,
        a docking station."""
        more.setdefault("line_of_sight", True)
        return cls(name="landmark", range_m=range_m, position_std_m=position_std_m, heading_std=heading_std, **more)

    @classmethod
    def heading(cls, range_m: float, heading_std: float, **more: Unpack[KindOptions]) -> BeaconKind:
        """A heading reference (rad) that leaves the position error: a wall of known direction, a light strip."""
        return cls(name="heading", range_m=range_m, heading_std=heading_std, **more)

    @classmethod
    def range_only(cls, range_m: float, range_std_m: float, **more: Unpack[KindOptions]) -> BeaconKind:
        """A radio to which the robot measures its distance (UWB); for a robot with a filter.

        >>> BeaconKind.range_only(range_m=30.0, range_std_m=0.1).needs_filter
        True
        """
        return cls(name="range_only", range_m=range_m, range_std_m=range_std_m, **more)

    @classmethod
    def bearing(cls, range_m: float, bearing_std: float, **more: Unpack[KindOptions]) -> BeaconKind:
        """A light or pattern whose direction (rad, in its own frame) the robot measures, in line of sight unless said
        otherwise; for a robot with a filter."""
        more.setdefault("line_of_sight", True)
        return cls(name="bearing", range_m=range_m, bearing_std=bearing_std, **more)

    @property
    def needs_filter(self) -> bool:
        """Whether it measures what only a robot with a filter can use."""
        return self.range_std_m is not None or self.bearing_std is not None


@dataclass(frozen=True, slots=True)
class Beacon:
    """A beacon at x, y (metres, world frame). Beacons without an ``id`` are numbered where an id is needed.

    ``facing_deg`` is which way it looks, degrees counter-clockwise from +x. A kind with a ``view_angle_deg`` needs it.

    >>> Beacon(BeaconKind.rfid(range_m=1.5, position_std_m=0.1), x=3.0, y=4.0, id="A7").id
    'A7'
    """

    kind: BeaconKind
    x: float
    y: float
    id: str = ""
    facing_deg: float | None = None

    def __post_init__(self) -> None:
        if self.facing_deg is not None:
            object.__setattr__(self, "facing_deg", number("facing_deg", self.facing_deg))
        elif self.kind.view_angle_deg < 360:
            raise ValueError(
                f"expected facing_deg, which way the beacon looks: it is seen from within "
                f"{self.kind.view_angle_deg:g} degrees of that only (view_angle_deg)"
            )
        for name in ("x", "y"):
            object.__setattr__(self, name, number(name, getattr(self, name)))

    @property
    def xy(self) -> Floats:
        """Metres, (2,)."""
        return np.array([self.x, self.y])
