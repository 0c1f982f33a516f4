"""BoxWorld: where a ball-shaped robot can fly among boxes, such as the bounding boxes of meshes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Bools, Floats, finite, not_negative, shaped


@dataclass(frozen=True, eq=False, kw_only=True)
class BoxWorld:
    """Boxes along the axes that a robot, a ball of ``robot_radius``, must not touch, within bounds it must not leave.

    The boxes are grown by the radius and keep their corners: whatever is accepted keeps the robot clear, refused is at
    most what comes within √3 radii of a corner. A point of contact counts as a collision. For `use_world` over R^3 and
    SE(3); boxes have no odometry of their own.

    Parameters
    ----------
    boxes : (n, 2, 3), the least and the greatest coordinates of each, metres
    bounds : (2, 3), of the space, metres
    robot_radius : metres, >= 0

    Raises ValueError if a box or the bounds are not from least to greatest, or anything is not finite.

    >>> hall = BoxWorld(boxes=[[(4, 0, 0), (6, 10, 3)]], bounds=[(0, 0, 0), (10, 10, 5)], robot_radius=0.5)
    >>> hall.is_free([[2, 5, 2], [5, 5, 2], [5, 5, 4]]).tolist()
    [True, False, True]
    >>> hall.segments_free([2, 5, 2], [[8, 5, 2], [3, 5, 4]]).tolist()
    [False, True]
    """

    boxes: Floats
    bounds: Floats
    robot_radius: float

    def __post_init__(self) -> None:
        boxes, bounds = finite("boxes", self.boxes), shaped("bounds", self.bounds, (2, 3))
        if boxes.ndim != 3 or boxes.shape[1:] != (2, 3):
            raise ValueError(f"expected boxes (n, 2, 3), got shape {boxes.shape}")
        for name, box in (("a box", boxes), ("bounds", bounds[None])):
            if wrong := np.flatnonzero((box[:, 0] > box[:, 1]).any(axis=1)).tolist():
                raise ValueError(f"expected {name} from least to greatest coordinates, got {box[wrong[0]].tolist()}")
        object.__setattr__(self, "boxes", boxes)
        object.__setattr__(self, "bounds", bounds)
        object.__setattr__(self, "robot_radius", not_negative("robot_radius", self.robot_radius))

    @cached_property
    def _grown(self) -> tuple[Floats, Floats]:
        """Middles and half sizes (n, 3) of the boxes, grown."""
        return self.boxes.mean(axis=1), np.diff(self.boxes, axis=1)[:, 0] / 2 + self.robot_radius

    @classmethod
    def around(cls, meshes: Iterable[ArrayLike], *, bounds: Sequence[ArrayLike], robot_radius: float) -> BoxWorld:
        """The boxes around meshes, each given by its vertices (k, 3)."""
        boxes = []
        for points in (finite("a mesh", mesh) for mesh in meshes):
            if points.ndim != 2 or points.shape[1] != 3 or not len(points):
                raise ValueError(f"expected a mesh of vertices (k, 3), k >= 1, got shape {points.shape}")
            boxes.append((points.min(axis=0), points.max(axis=0)))
        return cls(boxes=np.reshape(boxes, (-1, 2, 3)), bounds=finite("bounds", bounds), robot_radius=robot_radius)

    def is_free(self, xyz: ArrayLike) -> Bools:
        """Whether the robot's centre may be at each of the points ``(..., 3)``; shape ``(...)``."""
        return self.segments_free(xyz, xyz)

    def segments_free(self, a: ArrayLike, b: ArrayLike) -> Bools:
        """Whether the robot can fly straight from ``a`` to ``b``, ``(..., 3)`` each, broadcast; shape ``(...)``.

        A box and a segment are apart where they are along one of the axes or square to the segment and an axis.
        (C. Ericson, Real-Time Collision Detection, 2005, sec. 5.3.3; without its tolerance.)
        """
        a, b = np.broadcast_arrays(finite("a", a), finite("b", b))
        low, high = self.bounds + self.robot_radius * np.array([[1.0], [-1.0]])
        inside = ((np.minimum(a, b) > low) & (np.maximum(a, b) < high)).all(axis=-1)
        middle, box = self._grown
        way, off = ((b - a) / 2)[..., None, :], ((a + b) / 2)[..., None, :] - middle
        half = np.abs(way)
        apart = (np.abs(off) > half + box).any(axis=-1)
        for i, j in ((1, 2), (2, 0), (0, 1)):
            across = np.abs(off[..., i] * way[..., j] - off[..., j] * way[..., i])
            apart |= across > box[:, i] * half[..., j] + box[:, j] * half[..., i]
        return np.asarray(inside & apart.all(axis=-1))

    def point_free(self, x: float, y: float, z: float) -> bool:
        """The answer of `is_free` for one point."""
        return bool(self.is_free((x, y, z)))

    def segment_free(self, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float) -> bool:
        """The answer of `segments_free` for one segment."""
        return bool(self.segments_free((x0, y0, z0), (x1, y1, z1)))
