"""What is printed and written about the drift along a path: as table (in degrees), JSON, CSV and GeoJSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import Enum
from math import degrees, isfinite
from typing import TYPE_CHECKING, Any

from driftplan.files import head, plain_numbers
from driftplan.tables import decimals, digits, rows_of, table

if TYPE_CHECKING:
    from driftplan.arrays import Floats
    from driftplan.model.drift import Drift
    from driftplan.model.point_drift import PointDrift


_MOST_ROWS = 15  # of a table of drift, unless its points were asked for one by one


def drift_table(drift: PointDrift, *, most: int = _MOST_ROWS) -> str:
    """Drift at points as a table for people; of more than ``most`` some, evenly, with the first and the last."""
    import numpy as np

    from driftplan.model.point_drift import PointDrift

    count = len(drift.distance)
    few = np.linspace(0, count - 1, min(most, count)).round().astype(int)
    more = f"\n{count - len(few)} more points are not shown: --json has them all" if len(few) < count else ""
    drift = PointDrift(drift.distance[few], drift.moments[few])
    rms, bias, radius = digits(drift.rms, drift.bias_norm, drift.radius(0.95))
    (heading,) = digits([degrees(std) for std in drift.heading_std], count=3)
    places = {"distance m": drift.distance, "x m": drift.xy[..., 0], "y m": drift.xy[..., 1]}
    columns = {name: decimals(values, 2) for name, values in places.items()}
    columns |= {"rms m": rms, "bias m": bias, "95 % radius m": radius, "heading std deg": heading}
    return table(columns) + more


def beyond_linear_text(drift: Drift) -> str:
    """What to say where a filter's prediction is not to be trusted; nothing if it is everywhere."""
    if not len(drift.beyond_linear):
        return ""
    first, last = drift.beyond_linear[0, 0], drift.beyond_linear[-1, 1]
    return (
        f"\nBetween {first:.1f} m and {last:.1f} m the heading is known to worse than 0.15 rad, or ranges and "
        "bearings come from too uncertain a direction: a filter goes wrong there, and so does this prediction."
    )


def path_csv(drift: Drift) -> bytes:
    """The waypoints as CSV that ``driftplan predict`` and ``compare`` read back."""
    lines = [f"{head('map')}x_m,y_m", *(f"{x!r},{y!r}" for x, y in plain_numbers(drift.xy.tolist()))]
    return ("\n".join(lines) + "\n").encode()


def drift_geojson(drift: Drift, properties: Mapping[str, Any]) -> bytes:
    """The path as a LineString in metres of the map's frame (not longitude and latitude), with its drift."""
    from driftplan.world.geojson_map import feature_collection

    rows, line = drift.to_dicts(), {"type": "LineString", "coordinates": drift.xy.tolist()}
    columns = {name: [row[name] for row in rows] for name in rows[0] if name not in ("x_m", "y_m")}
    held = {"kind": "route", **properties, **columns}
    return feature_collection([_plain({"type": "Feature", "geometry": line, "properties": held})])


def record(thing: object, *keys: str) -> dict[str, Any]:
    """Attributes by names that carry their unit: ``length_m`` is the attribute of that name, or else ``length``.

    >>> record(1 + 2j, "real", "imag_m")
    {'real': 1.0, 'imag_m': 2.0}
    """
    return {key: getattr(thing, key if hasattr(thing, key) else key.rpartition("_")[0]) for key in keys}


def waypoints(path: Floats) -> list[dict[str, float]]:
    """Points (n, 2) by the names that everything has."""
    return rows_of({"x_m": path[:, 0], "y_m": path[:, 1]})


def json_text(value: Any) -> str:
    """JSON that any parser reads: named tuples are objects, and what is not finite becomes null."""
    return json.dumps(_plain(value), indent=2, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.name.lower()
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not isfinite(value):
        return None
    return value
