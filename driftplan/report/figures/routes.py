"""Figures of routes: their drift against distance, side by side, among beacons, less drift for more length, and where
they may touch walls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from math import floor, log10
from typing import TYPE_CHECKING, Any

import numpy as np

from driftplan.arrays import number
from driftplan.report.figures import maps, style
from driftplan.tables import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from driftplan.beacons.beacon import Beacon
    from driftplan.model.drift import Drift
    from driftplan.planning.collision_chance import CollisionChance
    from driftplan.planning.routes import Route
    from driftplan.world.world import World


def plot_drift(
    route: Route | Drift,
    *,
    ax: Axes | None = None,
    label: str | None = None,
    spacing_m: float | None = None,
    radius_at: float | None = None,
    **line_kwargs: Any,
) -> list[Line2D]:
    """Draw the rms drift against the distance driven, marked where `plot_route` draws its ellipses.

    Parameters
    ----------
    spacing_m : metres between marks; default as in `plot_route`
    radius_at : draw, thin, the radius that holds the estimate with this confidence too

    Returns list of Line2D: the rms, and the radius if asked for.

    >>> from matplotlib.figure import Figure
    >>> from driftplan import OdometryNoise, predict_drift
    >>> drift = predict_drift([(0, 0), (3, 0), (3, 1)], OdometryNoise(heading_var_per_m=1e-4))
    >>> [line.get_label() for line in plot_drift(drift, ax=Figure().subplots(), label="mine", radius_at=0.95)]
    ['mine', '95 % within this radius']
    """
    ax = style.current_axes(ax)
    drift = maps.drift_of(route)
    profile, marks = maps.marked_profile(drift, maps.mark_spacing_of([drift], spacing_m))
    look = {"linewidth": 1.8, "markersize": 4, "label": label, **style.own_look(ax, line_kwargs)}
    lines = ax.plot(profile.distance, profile.rms, markevery=marks, **look)
    if radius_at is not None:
        legend = f"{100 * number('radius_at', radius_at):g} % within this radius"
        thin: dict[str, Any] = {"color": lines[0].get_color(), "linestyle": (0, (1, 1.5)), "linewidth": 1.2}
        thin |= {"marker": lines[0].get_marker(), "markevery": marks, "markersize": 5, "markerfacecolor": "white"}
        lines += ax.plot(profile.distance, profile.radius(radius_at), label=legend, **thin)
    ax.set(xlabel="distance driven (m)", ylabel="rms drift (m)" if radius_at is None else "drift (m)")
    ax.update_datalim([(0.0, 0.0)])
    for line in lines:  # no margin below zero; limits stay automatic, for whatever is drawn next
        line.sticky_edges.x.append(0.0)
        line.sticky_edges.y.append(0.0)
    ax.autoscale_view()
    style.quiet_grid(ax)
    return list(lines)


def plot_comparison(
    world: World | None, routes: Mapping[str, Route | Drift], *, figure: Figure | None = None, confidence: float = 0.95
) -> Figure:
    """Routes on the map with their error ellipses, and beside it their rms drift against the distance driven.

    Of more than five routes those that drift most have a style and ellipses; the others are grey, and counted.

    Parameters
    ----------
    world : none: no map is drawn, the view is that of the routes
    routes : mapping of label to Route or Drift
    figure : an empty figure to draw into, such as ``pyplot.figure(layout="constrained")``; default: a new one that
        knows nothing of pyplot
    confidence : of the error ellipses

    >>> from driftplan import OdometryNoise, predict_drift
    >>> drift = predict_drift([(0, 0), (3, 0), (3, 1)], OdometryNoise(heading_var_per_m=1e-4))
    >>> plot_comparison(None, {"round the corner": drift}).axes[0].get_title()
    'round the corner: rms drift of 0.0351 m at the end'
    """
    if not routes:
        raise ValueError("expected at least one route to draw, got none")
    drifts = {label: maps.drift_of(route) for label, route in routes.items()}
    spacing = maps.mark_spacing_of(list(drifts.values()), None)
    box = maps.box_around(*(d.profile().xy for d in drifts.values())) if world is None else world.bounds
    magnify = maps.magnification(list(drifts.values()), maps.diagonal(box), confidence)
    figure, on_map, on_drift = style.map_and_curve(figure, box)
    drawn_world = None if world is None else maps.plot_world(world, ax=on_map)
    drawn, handles = [], list[Any]()
    ranked = sorted(drifts, key=lambda label: -float(drifts[label].end.rms))
    others = ranked[len(style.ROUTE_STYLES) :]
    for label, own in zip([label for label in drifts if label not in others], style.ROUTE_STYLES, strict=False):
        drift = drifts[label]
        look = {"magnify": magnify, "confidence": confidence, "spacing_m": spacing, **own}
        drawn.append(maps.plot_route(drift, ax=on_map, **look))
        legend = f"{label}: {_metric(float(drift.length))} m, rms {_metric(float(drift.end.rms))} m at the end"
        handles += plot_drift(drift, ax=on_drift, label=legend, spacing_m=spacing, **own)
    for label in others:
        grey = on_map.plot(*drifts[label].xy.T, **style.OTHER_ROUTE)
        plot_drift(drifts[label], ax=on_drift, spacing_m=spacing, **style.OTHER_ROUTE)
        if label == others[0]:
            grey[0].set_label(f"{len(others)} more, rms {_metric(float(drifts[label].end.rms))} m or less at the end")
            handles += grey
    on_map.set_title(_finding(drifts), fontsize=10)
    handles += [drawn[0].start, drawn[0].goal, drawn[0].ellipses[0]]
    handles += [patch for patch in (drawn_world.obstacles, *drawn_world.zones[:1]) if patch] if drawn_world else []
    style.legend_below(figure, handles)
    return figure


def _finding(drifts: Mapping[str, Drift]) -> str:
    """Which route drifts least, and by how much less than the one that drifts most."""
    ranked = sorted(drifts, key=lambda label: float(drifts[label].end.rms))
    least, most = ranked[0], ranked[-1]
    low, high = (float(drifts[label].end.rms) for label in (least, most))
    if (count := len(drifts)) > len(style.ROUTE_STYLES):
        return f"of {count} routes {most} drifts most, {_metric(high)} m rms at the end; the least {_metric(low)} m"
    if count == 1:
        return f"{least}: rms drift of {_metric(low)} m at the end"
    if not low < 0.995 * high:
        return f"all end with about the same drift, {_metric(low)} m rms"
    return f"{least}: {100 * (1 - low / high):.0f} % less drift at the end than {most}"


def _metric(value_m: float) -> str:
    """Three significant digits, and no more than millimetres need."""
    digits = 2 - floor(log10(abs(value_m))) if value_m else 0
    return f"{value_m:.{min(max(digits, 0), 4)}f}"


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
    maps.plot_world(world, ax=on_map)
    drawn = maps.plot_beacons(beacons or itinerary.beacons, ax=on_map, used=itinerary.beacons)
    own = style.ROUTE_STYLES[0]
    route = maps.plot_route(itinerary, ax=on_map, **own)
    label = f"{itinerary.length:.4g} m, worst {itinerary.worst_drift:.3g} m, at the end {itinerary.rms:.3g} m"
    lines = plot_drift(itinerary, ax=on_drift, label=label, **own)
    title = f"{counted(len(itinerary.beacons), 'beacon')} counted on: worst drift {itinerary.worst_drift:.3g} m"
    if itinerary.max_drift is not None:
        lines.append(on_drift.axhline(itinerary.max_drift, label=f"limit {itinerary.max_drift:g} m", **style.LIMIT))
        title += f", under the limit of {itinerary.max_drift:g} m"
    on_map.set_title(title, fontsize=10)
    ends = [route.start, route.goal, *route.ellipses[:1]]
    style.legend_below(figure, [*lines, *ends, *drawn.marks])
    return figure


def plot_pareto(world: World, routes: Sequence[Route], *, figure: Figure | None = None) -> Figure:
    """Routes of a trade-off on the map, and their worst drift against their length with the knee marked.

    Parameters
    ----------
    routes : as `driftplan.planning.comparison.pareto_routes` returns them

    >>> from driftplan import OdometryNoise, World, plan_route
    >>> hall = World.from_polygons([], bounds=(0, 0, 30, 9), robot_radius=0.5)
    >>> route = plan_route(hall, (1, 4), (29, 4), OdometryNoise(distance_var_per_m=0.01), iterations=1)
    >>> plot_pareto(hall, [route]).axes[1].get_xlabel()
    'length (m)'
    """
    from driftplan.planning.comparison import knee

    best = knee(routes)
    figure, on_map, on_curve = style.map_and_curve(figure, world.bounds)
    maps.plot_world(world, ax=on_map)
    used = {id(beacon): beacon for route in routes for beacon in route.beacons}
    drawn = maps.plot_beacons(list(used.values()), ax=on_map, used=list(used.values()))
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


def plot_collisions(world: World, chance: CollisionChance, *, figure: Figure | None = None) -> Figure:
    """The route on the map, the darker the likelier the robot is in a wall there, and that chance against the distance
    with the share of simulated drives that have touched a wall by then.

    >>> from driftplan import OdometryNoise, World, collision_chance, predict_drift
    >>> world = World.from_polygons([[(0, 2), (9, 2), (9, 3), (0, 3)]], bounds=(0, -9, 9, 3), robot_radius=0.5)
    >>> drift = predict_drift([(1, 1), (8, 1)], OdometryNoise(lateral_var_per_m=0.01))
    >>> len(plot_collisions(world, collision_chance(drift, world)).axes)
    3
    """
    from matplotlib.collections import LineCollection

    figure, on_map, on_curve = style.map_and_curve(figure, world.bounds)
    drawn = maps.plot_world(world, ax=on_map)
    on_map.plot(*chance.xy.T, color="black", linewidth=5.5, solid_capstyle="round", zorder=2.9)
    ways = np.stack([chance.xy[:-1], chance.xy[1:]], axis=1)
    greater = np.maximum(chance.at[:-1], chance.at[1:])
    line = on_map.add_collection(LineCollection(list(ways), array=greater, cmap="YlOrRd", linewidths=4, zorder=3))
    line.set_clim(0.0, max(float(greater.max()), 1e-6))
    figure.colorbar(line, ax=on_map, label="chance of being in a wall there", shrink=0.7)
    worst = int(chance.at.argmax())
    on_map.annotate(f"{100 * chance.at[worst]:.2g} %", chance.xy[worst], (9, 9), textcoords="offset points", zorder=5)
    interval = f"95 %: {100 * chance.low:.2g} to {100 * chance.high:.2g} %"
    title = f"{100 * chance.probability:.3g} % of {chance.runs} drives touch a wall ({interval})"
    on_map.set_title(title, fontsize=10)
    bare = {"marker": ""}
    curves = [
        *on_curve.plot(chance.distance, chance.by, label="has touched a wall by then", **style.ROUTE_STYLES[0] | bare),
        *on_curve.plot(chance.distance, chance.at, label="is in a wall there", **style.ROUTE_STYLES[1] | bare),
    ]
    on_curve.set(xlabel="distance driven (m)", ylabel="chance", xlim=(0.0, float(chance.distance[-1])))
    on_curve.set_ylim(bottom=0.0)
    style.quiet_grid(on_curve)
    walls = [] if drawn.obstacles is None else [drawn.obstacles]
    style.legend_below(figure, [*curves, *style.mark_ends(on_map, [chance.xy]), *walls])
    return figure
