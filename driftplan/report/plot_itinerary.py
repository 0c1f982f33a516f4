"""Figures of itineraries: the route among its beacons, its sawtooth of drift, and what less drift costs in length."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from driftplan.beacons.beacon import Beacon
from driftplan.planning.pareto import knee
from driftplan.report.plotting import ROUTE_STYLES, plot_drift, plot_route, plot_world

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PatchCollection
    from matplotlib.figure import Figure

    from driftplan.planning.routes import Route
    from driftplan.world.world import World

_USED: dict[str, Any] = {"facecolor": "#E69F00", "edgecolor": "#8A5F00", "alpha": 0.35, "linewidth": 0.9}
_UNUSED: dict[str, Any] = {"facecolor": "none", "edgecolor": "0.55", "linestyle": ":", "linewidth": 0.8}


def plot_beacons(beacons: Sequence[Beacon], *, ax: Axes, used: Sequence[Beacon] = ()) -> list[PatchCollection]:
    """Draw ranges of beacons on a map: filled for those ``used``, dotted outlines for the others.

    Returns
    -------
    list of PatchCollection
        The used ones, then the others; those there are.
    """
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle

    counted = {id(beacon) for beacon in used}
    drawn: list[PatchCollection] = []
    for is_used, look, label in ((True, _USED, "beacon counted on"), (False, _UNUSED, "other beacon")):
        group = [beacon for beacon in beacons if (id(beacon) in counted) == is_used]
        if group:
            discs = PatchCollection([Circle((b.x, b.y), b.kind.range_m) for b in group], **look)
            discs.set(label=label, zorder=1.5)
            ax.add_collection(discs)
            drawn.append(discs)
            mark = "x" if is_used else "."
            ax.plot([b.x for b in group], [b.y for b in group], mark, color=look["edgecolor"], markersize=4, zorder=2)
    return drawn


def plot_itinerary(
    world: World, itinerary: Route, beacons: Sequence[Beacon] = (), *, figure: Figure | None = None
) -> Figure:
    """The route on the map with the beacons it counts on, and its drift against the distance with the limit.

    Parameters
    ----------
    world : World
    itinerary : Route
    beacons : sequence of Beacon
        All there are; default: those counted on.
    figure : Figure, optional
        An empty one to draw into; default: a new one that knows nothing of pyplot.
    """
    figure, on_map, on_drift = _two_panels(figure, world)
    plot_world(world, ax=on_map)
    drawn = plot_beacons(beacons or itinerary.beacons, ax=on_map, used=itinerary.beacons)
    style = ROUTE_STYLES[0]
    route = plot_route(itinerary, ax=on_map, **style)
    said = f"{itinerary.length:.4g} m, worst {itinerary.worst_drift:.3g} m, at the end {itinerary.rms:.3g} m"
    lines = plot_drift(itinerary, ax=on_drift, label=said, **style)
    if itinerary.max_drift is not None:
        lines.append(
            on_drift.axhline(
                itinerary.max_drift, color="0.3", linestyle="--", label=f"limit {itinerary.max_drift:g} m", linewidth=1
            )
        )
    ends = [route.start, route.goal, *route.ellipses[:1]]
    figure.legend(handles=[*lines, *ends, *_keys(drawn)], loc="outside lower center", ncols=2, frameon=False)
    return figure


def plot_pareto(world: World, routes: Sequence[Route], *, figure: Figure | None = None) -> Figure:
    """Routes of a trade-off on the map, and their worst drift against their length with the knee marked.

    Parameters
    ----------
    world : World
    routes : sequence of Route
        As `driftplan.planning.pareto.pareto_routes` returns them.
    figure : Figure, optional
        An empty one to draw into; default: a new one that knows nothing of pyplot.
    """
    best = knee(routes)
    figure, on_map, on_curve = _two_panels(figure, world)
    plot_world(world, ax=on_map)
    used = {id(beacon): beacon for route in routes for beacon in route.beacons}
    drawn = plot_beacons(list(used.values()), ax=on_map, used=list(used.values()))
    lines = []
    for k, (route, style) in enumerate(zip(routes, cycle(ROUTE_STYLES), strict=False)):
        said = f"{route.length:.4g} m, worst {route.worst_drift:.3g} m, at the end {route.rms:.3g} m"
        look: dict[str, Any] = {**style, "linewidth": 1.8, "markersize": 4}
        lines += on_map.plot(*route.path.T, label=said + (" (knee)" if k == best else ""), **look)
        on_curve.plot([route.length], [route.worst_drift], style["marker"], color=style["color"], markersize=7)
    curve = np.array([(route.length, route.worst_drift) for route in routes])
    on_curve.plot(*curve.T, color="0.6", linewidth=1, zorder=1)
    on_curve.plot(*curve[best], "o", markersize=15, markerfacecolor="none", markeredgecolor="black", label="knee")
    on_curve.annotate("knee", curve[best], xytext=(9, 9), textcoords="offset points")
    on_curve.set(xlabel="length (m)", ylabel="worst rms drift on the way (m)")
    on_curve.grid(visible=True, color="0.9", linewidth=0.6)
    on_curve.set_ylim(bottom=0.0)
    figure.legend(handles=[*lines, *_keys(drawn)], loc="outside lower center", ncols=2, frameon=False)
    return figure


def _keys(drawn: Sequence[PatchCollection]) -> list[Any]:
    """Patches that stand for collections in a legend, which has no handler for those."""
    from matplotlib.patches import Patch

    looks = {"beacon counted on": _USED, "other beacon": _UNUSED}
    return [Patch(label=str(group.get_label()), **looks[str(group.get_label())]) for group in drawn]


def _two_panels(figure: Figure | None, world: World) -> tuple[Figure, Axes, Axes]:
    from matplotlib.figure import Figure

    xmin, ymin, xmax, ymax = world.bounds
    if figure is None:
        figure = Figure(figsize=(12, 2.2 + min(max(7 * (ymax - ymin) / (xmax - xmin), 3), 10)), layout="constrained")
    on_map, on_curve = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
    on_map.set(xlim=(xmin, xmax), ylim=(ymin, ymax))
    return figure, on_map, on_curve
