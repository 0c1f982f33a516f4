"""compare_routes: routes side by side, as a table."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from driftplan.model.drift import Drift
from driftplan.planning.collision_chance import collision_chance
from driftplan.planning.routes import Route
from driftplan.tables import NONE, Rows, decimals, digits, yes_no
from driftplan.world.world import World


@dataclass(frozen=True, kw_only=True)
class Comparison(Rows):
    """Routes side by side; printing it prints a table.

    Attributes
    ----------
    rows : one per route: name, length_m, rms_m, bias_m (its norm), radius95_m, all at the goal, planner (None for
        paths of your own), and estimator; how many beacons each counts on, where one does; collision_free, where
        a world was given; of collisions the chance, low, high and bound (`CollisionChance`), where asked for

    >>> from driftplan import OdometryNoise, predict_drift
    >>> drives = [predict_drift([(0, 0), end], OdometryNoise(distance_var_per_m=0.01)) for end in ((9, 0), (0, 25))]
    >>> [(row["name"], round(row["rms_m"], 2)) for row in compare_routes(drives, ["east", "north"]).rows]
    [('east', 0.3), ('north', 0.5)]
    """

    def columns(self) -> dict[str, Iterable[object]]:
        """What people read: headings and cells."""
        rows = self.rows
        rms, bias, radius = digits(*([row[key] for row in rows] for key in ("rms_m", "bias_m", "radius95_m")))
        columns: dict[str, Iterable[object]] = {
            "route": [row["name"] for row in rows],
            "length m": decimals([row["length_m"] for row in rows], 2),
            "rms m": rms,
            "bias m": bias,
            "radius95 m": radius,
        }
        least = min((row["rms_m"] for row in rows if row.get("collision_free", True)), default=0.0)
        if len(rows) > 1 and least > 0:
            columns["above least %"] = [f"{100 * (row['rms_m'] / least - 1):+.1f}" for row in rows]
        if all("beacons" in row for row in rows):
            columns["beacons"] = [str(row["beacons"]) for row in rows]
        if any(row["estimator"] == "filter" for row in rows):
            columns["estimator"] = [row["estimator"] for row in rows]
        columns["planner"] = [row["planner"] or NONE for row in rows]
        if all("collision_free" in row for row in rows):
            columns["collision-free"] = yes_no(row["collision_free"] for row in rows)
        if all("collision_probability" in row for row in rows):
            columns["touches a wall %"] = [_percent(row["collision_probability"]) for row in rows]
            columns["at most %"] = [_percent(row["collision_bound"]) for row in rows]
        return columns


def compare_routes(
    routes: Sequence[Route | Drift],
    names: Sequence[str] | None = None,
    *,
    world: World | None = None,
    collisions: World | None = None,
) -> Comparison:
    """Length and drift of routes, side by side.

    Parameters
    ----------
    routes : sequence of Route or Drift; a `Drift` is that of a path of your own
    names : default: what each minimises, "given" for paths of your own
    world : say of every route whether it is free of collisions there, so that paths through walls do not set the
        standard
    collisions : say of every route how likely a robot of that world touches a wall there (`collision_chance`)

    Raises
    ------
    ValueError : for no routes, or another number of names

    >>> from driftplan import OdometryNoise, World, plan_route
    >>> world = World.from_polygons([], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    >>> route = plan_route(world, (2, 2), (8, 2), noise, time_limit=0.1)
    >>> print(compare_routes([route]))
    route  length m   rms m  bias m  radius95 m  planner
    drift      6.00  0.0608  0.0003      0.1057  roadmap
    """
    if not routes or not all(isinstance(route, (Route, Drift)) for route in routes):
        raise ValueError("expected at least one Route, as plan_route returns it, or Drift, as predict_drift does")
    if names is not None and len(names) != len(routes):
        raise ValueError(f"expected a name for each of {len(routes)} routes, got {len(names)}")
    rows = tuple(_row(route, names[k] if names else None, world, collisions) for k, route in enumerate(routes))
    planned = [route if isinstance(route, Route) else None for route in routes]
    if any(route is not None and route.captures for route in planned):
        for row, route in zip(rows, planned, strict=True):
            row["beacons"] = 0 if route is None else len(route.beacons)
    return Comparison(rows=rows)


def _row(route: Route | Drift, name: str | None, world: World | None, collisions: World | None) -> dict[str, Any]:
    drift, planned = (route, None) if isinstance(route, Drift) else (route.drift, route)
    end = drift.end
    row = {
        "name": name or (planned.minimise if planned else "given"),
        "length_m": float(drift.length),
        "rms_m": float(end.rms),
        "bias_m": float(end.bias_norm),
        "radius95_m": float(end.radius(0.95)),
        "planner": planned.planner if planned else None,
        "estimator": drift.estimator,
    }
    if world is not None:
        row["collision_free"] = bool(world.segments_free(drift.xy[:-1], drift.xy[1:]).all())
    if collisions is not None:
        chance = collision_chance(drift, collisions)
        row |= {f"collision_{key}": getattr(chance, key) for key in ("probability", "low", "high", "bound")}
    return row


def _percent(probability: float) -> str:
    return f"{100 * probability:.1f}"
