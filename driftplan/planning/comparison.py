"""compare_routes: routes side by side, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from driftplan.planning.routes import Route


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Routes side by side; printing it prints a table.

    Attributes
    ----------
    rows : tuple of dict
        One per route: name, length_m, rms_m, bias_m (its norm), radius95_m, all at the goal, and planner; with routes
        that count on beacons among them also how many beacons each does.
    """

    rows: tuple[dict[str, Any], ...]

    def to_dicts(self) -> list[dict[str, Any]]:
        """Copies of the rows, for pandas and JSON."""
        return [dict(row) for row in self.rows]

    def __str__(self) -> str:
        counted = all("beacons" in row for row in self.rows)
        header = ("route", "length m", "rms m", "bias m", "radius95 m", *(["beacons"] if counted else []), "planner")
        lines = [
            [
                row["name"],
                *(f"{row[key]:.3f}" for key in ("length_m", "rms_m", "bias_m", "radius95_m")),
                *([str(row["beacons"])] if counted else []),
                row["planner"],
            ]
            for row in self.rows
        ]
        widths = [max(len(line[k]) for line in (header, *lines)) for k in range(len(header))]
        left = (0, len(header) - 1)
        return "\n".join(
            "  ".join(f"{cell:{'<' if k in left else '>'}{widths[k]}}" for k, cell in enumerate(line)).rstrip()
            for line in (header, *lines)
        )


def compare_routes(routes: Sequence[Route], names: Sequence[str] | None = None) -> Comparison:
    """Length and drift of routes, side by side.

    Parameters
    ----------
    routes : sequence of Route
    names : sequence of str, optional
        Default: what each minimises.

    Raises
    ------
    ValueError
        For no routes, or another number of names.

    Examples
    --------
    >>> from driftplan.planning.routes import plan_route
    >>> from driftplan.world.world import World
    >>> world = World.from_polygons([], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> from driftplan.model.noise import OdometryNoise
    >>> noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    >>> route = plan_route(world, (2, 2), (8, 2), noise, time_limit=0.1)
    >>> print(compare_routes([route]))
    route  length m  rms m  bias m  radius95 m  planner
    drift     6.000  0.061   0.000       0.106  roadmap
    """
    if not routes or not all(isinstance(route, Route) for route in routes):
        raise ValueError("expected at least one Route, as plan_route returns it")
    if names is not None and len(names) != len(routes):
        raise ValueError(f"expected a name for each of {len(routes)} routes, got {len(names)}")
    rows: list[dict[str, Any]] = []
    for k, route in enumerate(routes):
        end = route.drift.end
        rows.append(
            {
                "name": names[k] if names is not None else route.minimise,
                "length_m": route.length,
                "rms_m": float(end.rms),
                "bias_m": float(end.bias_norm),
                "radius95_m": float(end.radius(0.95)),
                "planner": route.planner,
            }
        )
    beacons = [getattr(route, "beacons", None) for route in routes]  # of an Itinerary
    if any(some is not None for some in beacons):
        for row, some in zip(rows, beacons, strict=True):
            row["beacons"] = len(some or ())
    return Comparison(rows=tuple(rows))
