"""Polygons in metres, as the public functions of the world accept them, checked at their edge."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from shapely import MultiPolygon, Polygon

from driftplan.arrays import points_of


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
