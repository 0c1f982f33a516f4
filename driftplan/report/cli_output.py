"""What the driftplan command prints and writes: tables, JSON, and files that are never half written.

Keys of JSON, CSV columns and GeoJSON properties carry their unit. Lengths are metres, angles radians; only tables for
people have degrees.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Mapping, Sequence
from math import degrees, floor, isfinite, log10
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

    from driftplan.model.drift import Drift, PointDrift

CONFIDENCE = 0.95  # of the radii in tables and JSON, and of the ellipses in figures
_POINT_TABLE = ("distance m", "x m", "y m", "rms m", "bias m", "95 % radius m", "heading std deg")


def drift_columns(drift: PointDrift) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """Drift at points, shape (k,), as named columns with units."""
    xy, bias, cov = drift.xy, drift.bias, drift.cov
    return {
        "distance_m": drift.distance,
        "x_m": xy[..., 0],
        "y_m": xy[..., 1],
        "rms_m": drift.rms,
        "bias_x_m": bias[..., 0],
        "bias_y_m": bias[..., 1],
        "cov_xx_m2": cov[..., 0, 0],
        "cov_xy_m2": cov[..., 0, 1],
        "cov_yy_m2": cov[..., 1, 1],
        "radius95_m": drift.radius(CONFIDENCE),
        "heading_std_rad": drift.heading_std,
    }


def drift_as_json(drift: PointDrift) -> list[dict[str, float]]:
    """One object per point."""
    columns = drift_columns(drift)
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in rows]


def drift_table(drift: PointDrift) -> str:
    """Drift at points as a table for people."""
    c = drift_columns(drift)
    columns = [
        _decimals(c["distance_m"], 2),
        _decimals(c["x_m"], 2),
        _decimals(c["y_m"], 2),
        _digits(c["rms_m"]),
        _digits(drift.bias_norm),
        _digits(c["radius95_m"]),
        _digits([degrees(std) for std in c["heading_std_rad"]], 3),
    ]
    return table(_POINT_TABLE, list(zip(*columns, strict=True)))


def routes_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Routes side by side, their drift at the end, and of several how much they have above the least."""
    columns = {
        "route": [row["name"] for row in rows],
        "length m": _decimals([row["length_m"] for row in rows], 2),
        "rms m": _digits([row["rms_m"] for row in rows]),
        "bias m": _digits([row["bias_m"] for row in rows]),
        "95 % radius m": _digits([row["radius95_m"] for row in rows]),
    }
    least = min((row["rms_m"] for row in rows if row["collision_free"]), default=0.0)
    if len(rows) > 1 and least > 0:
        columns["above least %"] = [f"{100 * (row['rms_m'] / least - 1):+.1f}" for row in rows]
    columns["collision-free"] = ["yes" if row["collision_free"] else "no" for row in rows]
    return table(list(columns), list(zip(*columns.values(), strict=True)))


def _decimals(values: Iterable[float], decimals: int) -> list[str]:
    return [f"{value:.{decimals}f}" for value in values]


def _digits(values: Iterable[float], digits: int = 4) -> list[str]:
    """As many decimals for all as the greatest of them needs to show ``digits`` digits, and at least two."""
    known = list(values)
    greatest = max((abs(value) for value in known if isfinite(value)), default=0.0)
    return _decimals(known, max(digits - 1 - floor(log10(greatest)), 2) if greatest > 0 else 2)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns as wide as they need to be: words to the left, numbers to the right.

    Examples
    --------
    >>> print(table(["route", "m"], [["a", "12.5"], ["shortest", "9.0"]]))
    route        m
    a         12.5
    shortest   9.0
    """
    columns = list(zip(header, *rows, strict=True))
    widths = [max(map(len, column)) for column in columns]
    words = [all(not _is_number(cell) for cell in column[1:]) for column in columns]
    lines = [
        "  ".join(cell.ljust(w) if left else cell.rjust(w) for cell, w, left in zip(line, widths, words, strict=True))
        for line in (header, *rows)
    ]
    return "\n".join(line.rstrip() for line in lines)


def json_text(value: Any) -> str:
    """JSON that any parser reads: what is not finite becomes null."""
    return json.dumps(_finite_or_null(value), indent=2, allow_nan=False)


def path_csv(drift: Drift) -> bytes:
    """The waypoints as CSV that ``driftplan predict`` and ``compare`` read back."""
    lines = ["x_m,y_m", *(f"{x!r},{y!r}" for x, y in drift.xy.tolist())]  # repr of a float: nothing is rounded
    return ("\n".join(lines) + "\n").encode()


def drift_geojson(drift: Drift, properties: Mapping[str, Any]) -> bytes:
    """The path as a LineString in metres of the map's frame (not longitude and latitude), with its drift."""
    columns = {name: values.tolist() for name, values in drift_columns(drift).items() if name not in ("x_m", "y_m")}
    feature = {
        "type": "Feature",
        "geometry": {"type": "LineString", "coordinates": drift.xy.tolist()},
        "properties": {"kind": "route", **properties, **columns},
    }
    return (json_text({"type": "FeatureCollection", "features": [feature]}) + "\n").encode()


def figure_png(figure: Figure) -> bytes:
    """A figure as PNG, by matplotlib's Agg renderer."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", bbox_inches="tight", pad_inches=0.12)
    return picture.getvalue()


def _is_number(cell: str) -> bool:
    try:
        float(cell.rstrip("%").strip() or "0")
    except ValueError:
        return False
    return True


def _finite_or_null(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite_or_null(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite_or_null(item) for item in value]
    if isinstance(value, float) and not isfinite(value):
        return None
    return value
