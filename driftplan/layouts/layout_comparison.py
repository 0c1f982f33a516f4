"""compare_layouts: layouts side by side, as a table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import nan
from typing import Any

from driftplan.layouts.layout import Layout
from driftplan.tables import Rows, decimals, digits, yes_no


@dataclass(frozen=True, kw_only=True)
class LayoutComparison(Rows):
    """Layouts side by side; printing it prints a table.

    Attributes
    ----------
    rows : one per layout: name, beacons (new ones), existing, cost, lower_bound, proven, routes, route_m
        (of all together), max_drift_m (the strictest limit), worst_drift_m, and worst_single_failure_m, the greatest
        drift with one beacon dead (nan without beacons)
    """

    def columns(self) -> dict[str, Iterable[object]]:
        """What people read: headings and cells."""
        rows = self.rows
        worst, failure = digits(*([row[key] for row in rows] for key in ("worst_drift_m", "worst_single_failure_m")))
        return {
            "layout": [row["name"] for row in rows],
            "beacons": [row["beacons"] for row in rows],
            "cost": [f"{row['cost']:g}" for row in rows],
            "at least": [f"{row['lower_bound']:g}" for row in rows],
            "proven": yes_no(row["proven"] for row in rows),
            "routes m": decimals([row["route_m"] for row in rows], 1),
            "limit m": [f"{row['max_drift_m']:.4g}" for row in rows],
            "worst drift m": worst,
            "with one dead m": failure,
        }


def compare_layouts(layouts: Mapping[str, Layout]) -> LayoutComparison:
    """What layouts cost and what they keep, side by side; their routes and limits need not be the same.

    Parameters
    ----------
    layouts : mapping of name to Layout

    Raises
    ------
    ValueError : for no layouts, or something else

    Examples
    --------
    >>> from driftplan import BeaconKind, OdometryNoise, Sites, place_beacons
    >>> noise = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
    >>> tag = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01)
    >>> routes, sites = {"short": [(0, 0), (30, 0)], "long": [(0, 0), (60, 0)]}, Sites(tag, spacing_m=2.0)
    >>> layouts = {name: place_beacons(None, route, noise, 0.8, sites) for name, route in routes.items()}
    >>> print(compare_layouts(layouts))
    layout  beacons  cost  at least  proven  routes m  limit m  worst drift m  with one dead m
    short         1     1         1  yes         30.0      0.8          0.794            1.050
    long          2     2         2  yes         60.0      0.8          0.794            2.448
    """
    if not isinstance(layouts, Mapping) or not layouts or not all(isinstance(x, Layout) for x in layouts.values()):
        raise ValueError(f"expected layouts by name, as {{'narrow': place_beacons(...)}}, got {layouts!r}")
    return LayoutComparison(rows=tuple(_row(name, layout) for name, layout in layouts.items()))


def _row(name: str, layout: Layout) -> dict[str, Any]:
    return {
        "name": name,
        "beacons": len(layout.beacons),
        "existing": len(layout.existing),
        "cost": layout.cost,
        "lower_bound": layout.lower_bound,
        "proven": layout.proven,
        "routes": len(layout.drifts),
        "route_m": sum(float(drift.length) for drift in layout.drifts),
        "max_drift_m": min(layout.max_drift),
        "worst_drift_m": layout.worst_drift,
        "worst_single_failure_m": max((x.worst_single_failure for x in layout.importance if x.routes), default=nan),
    }
