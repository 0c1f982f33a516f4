"""Figures of itineraries: the route among its beacons, its sawtooth of drift, and what less drift costs in length."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from driftplan.report.figures import style
from driftplan.report.figures.drift import plot_drift
from driftplan.report.figures.maps import plot_beacons, plot_route, plot_world
from driftplan.tables import counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from driftplan.beacons.beacon import Beacon
    from driftplan.planning.routes import Route
    from driftplan.world.world import World


def plot_itinerary(
    world: World, itinerary: Route, beacons: Sequence[Beacon] = (), *, figure: Figure | None = None
) -> Figure:
    """The route on the map with the beacons it counts on, and its drift against the distance with the limit.

    Parameters
    ----------
    beacons : all there are; default: those counted on

    >>> from driftplan import Beacon, BeaconKind, OdometryNoise, World, plan_route
    >>> hall, tag = World.from_polygons([], bounds=(0, 0, 30, 9), robot_radius=0.5), BeaconKind.rfid(1.5, 0.1)
    >>> asked = {"beacons": [Beacon(tag, 15, 4)], "minimise": "length", "iterations": 1}
    >>> route = plan_route(hall, (1, 4), (29, 4), OdometryNoise(distance_var_per_m=0.01), max_drift=0.5, **asked)
    >>> plot_itinerary(hall, route).axes[0].get_title()
    '1 beacon counted on: worst drift 0.381 m, under the limit of 0.5 m'
    """
    figure, on_map, on_drift = style.map_and_curve(figure, world.bounds)
    plot_world(world, ax=on_map)
    drawn = plot_beacons(beacons or itinerary.beacons, ax=on_map, used=itinerary.beacons)
    own = style.ROUTE_STYLES[0]
    route = plot_route(itinerary, ax=on_map, **own)
    label = f"{itinerary.length:.4g} m, worst {itinerary.worst_drift:.3g} m, at the end {itinerary.rms:.3g} m"
    lines = plot_drift(itinerary, ax=on_drift, label=label, **own)
    if itinerary.max_drift is not None:
        lines.append(on_drift.axhline(itinerary.max_drift, label=f"limit {itinerary.max_drift:g} m", **style.LIMIT))
    limit = "" if itinerary.max_drift is None else f", under the limit of {itinerary.max_drift:g} m"
    on_map.set_title(
        f"{counted(len(itinerary.beacons), 'beacon')} counted on: worst drift {itinerary.worst_drift:.3g} m{limit}",
        fontsize=10,
    )
    ends = [route.start, route.goal, *route.ellipses[:1]]
    style.legend_below(figure, [*lines, *ends, *drawn.marks])
    return figure


def plot_pareto(world: World, routes: Sequence[Route], *, figure: Figure | None = None) -> Figure:
    """Routes of a trade-off on the map, and their worst drift against their length with the knee marked.

    Parameters
    ----------
    routes : as `driftplan.planning.pareto.pareto_routes` returns them

    >>> from driftplan import OdometryNoise, World, plan_route
    >>> hall = World.from_polygons([], bounds=(0, 0, 30, 9), robot_radius=0.5)
    >>> route = plan_route(hall, (1, 4), (29, 4), OdometryNoise(distance_var_per_m=0.01), iterations=1)
    >>> plot_pareto(hall, [route]).axes[1].get_xlabel()
    'length (m)'
    """
    from driftplan.planning.pareto import knee

    best = knee(routes)
    figure, on_map, on_curve = style.map_and_curve(figure, world.bounds)
    plot_world(world, ax=on_map)
    used = {id(beacon): beacon for route in routes for beacon in route.beacons}
    drawn = plot_beacons(list(used.values()), ax=on_map, used=list(used.values()))
    lines = []
    for k, (route, own) in enumerate(zip(routes, cycle(style.ROUTE_STYLES), strict=False)):
        label = f"{route.length:.4g} m, worst {route.worst_drift:.3g} m, at the end {route.rms:.3g} m"
        look: dict[str, Any] = {**own, "linewidth": 1.8, "markersize": 4}
        lines += on_map.plot(*route.path.T, label=label + (" (knee)" if k == best else ""), **look)
        style.arrow_along(on_map, route.path, own["color"])
        on_curve.plot([route.length], [route.worst_drift], own["marker"], color=own["color"], markersize=7)
    curve = np.array([(route.length, route.worst_drift) for route in routes])
    on_curve.plot(*curve.T, color="0.6", linewidth=1, zorder=1)
    on_curve.plot(*curve[best], "o", markersize=15, markerfacecolor="none", markeredgecolor="black", label="knee")
    on_curve.set(xlabel="length (m)", ylabel="worst rms drift on the way (m)")
    style.quiet_grid(on_curve)
    on_curve.set_ylim(0.0, 1.15 * curve[:, 1].max())
    on_curve.legend(loc="lower right", fontsize=8)
    low, short = curve[curve[:, 1].argmin()], curve[curve[:, 0].argmin()]
    farther = f"{low[0] - short[0]:.3g} m farther than the shortest"
    on_map.set_title(f"{farther}: worst drift {low[1]:.3g} m instead of {short[1]:.3g} m", fontsize=10)
    style.legend_below(figure, [*lines, *style.mark_ends(on_map, [routes[0].path]), *drawn.marks])
    return figure
