"""What the public functions of the world accept, checked at their edge: points, bounds and polygons in metres."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPolygon, Polygon

Floats = NDArray[np.float64]


def points_of(name: str, value: ArrayLike) -> Floats:
    try:
        points = np.asarray(value, dtype=float)
    except (TypeError, ValueError) as err:
        raise ValueError(f"expected {name} to be an array of points (..., 2) in metres, got {value!r}") from err
    if points.ndim < 1 or points.shape[-1] != 2:
        raise ValueError(f"expected {name} to be points (..., 2) in metres, got an array of shape {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError(f"expected {name} finite, got NaN or infinite coordinates")
    return points


def point_of(name: str, value: ArrayLike) -> tuple[float, float]:
    point = points_of(name, value)
    if point.shape != (2,):
        raise ValueError(f"expected {name} to be one point (2,), got an array of shape {point.shape}")
    return float(point[0]), float(point[1])


def bounds_of(value: Sequence[float]) -> tuple[float, float, float, float]:
    bounds = tuple(float(v) for v in value)
    if len(bounds) != 4 or not all(isfinite(v) for v in bounds) or bounds[0] >= bounds[2] or bounds[1] >= bounds[3]:
        raise ValueError(f"expected bounds (xmin, ymin, xmax, ymax), finite and not empty, got {bounds!r}")
    return bounds


def polygon_of(name: str, value: Any) -> Polygon | MultiPolygon:
    """A valid polygon or multipolygon of finite coordinates."""
    if not isinstance(value, (Polygon, MultiPolygon)):
        corners = points_of(name, value)
        if corners.ndim != 2 or len(corners) < 3:
            raise ValueError(f"expected {name} to have 3 or more corners (n, 2), got an array of shape {corners.shape}")
        value = Polygon(corners)
    if value.is_empty or not np.isfinite(shapely.get_coordinates(value)).all():
        raise ValueError(f"expected {name} to be finite and not empty, got {value.wkt[:80]}")
    if not value.is_valid:
        raise ValueError(f"expected {name} to be a valid polygon, got {shapely.is_valid_reason(value)}")
    return value
