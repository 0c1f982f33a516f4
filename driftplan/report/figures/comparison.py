"""The figure of routes side by side: on the map, and their drift against distance."""

from __future__ import annotations

from collections.abc import Mapping
from math import floor, log10
from typing import TYPE_CHECKING, Any

from driftplan.report.figures import style
from driftplan.report.figures.drift import plot_drift
from driftplan.report.figures.ellipses import magnification
from driftplan.report.figures.maps import (
    RouteArtists,
    WorldArtists,
    box_around,
    diagonal,
    drift_of,
    mark_spacing_of,
    plot_route,
    plot_world,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from driftplan.model.drift import Drift
    from driftplan.planning.routes import Route
    from driftplan.world.world import World


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
    drifts = {label: drift_of(route) for label, route in routes.items()}
    spacing = mark_spacing_of(list(drifts.values()), None)
    box = box_around(*(d.profile().xy for d in drifts.values())) if world is None else world.bounds
    magnify = magnification(list(drifts.values()), diagonal(box), confidence)
    figure, on_map, on_drift = style.map_and_curve(figure, box)
    drawn_world = plot_world(world, ax=on_map) if world is not None else WorldArtists(None, [])
    drawn: list[RouteArtists] = []
    handles: list[Any] = []
    ranked = sorted(drifts, key=lambda label: -float(drifts[label].end.rms))
    others = ranked[len(style.ROUTE_STYLES) :]
    named = {label: drift for label, drift in drifts.items() if label not in others}
    for (label, drift), own in zip(named.items(), style.ROUTE_STYLES, strict=False):
        drawn.append(plot_route(drift, ax=on_map, magnify=magnify, spacing_m=spacing, confidence=confidence, **own))
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
    handles += [patch for patch in (drawn_world.obstacles, *drawn_world.zones[:1]) if patch is not None]
    style.legend_below(figure, handles)
    return figure


def _finding(drifts: Mapping[str, Drift]) -> str:
    """Which route drifts least, and by how much less than the one that drifts most."""
    least, *_, most = sorted(drifts, key=lambda label: float(drifts[label].end.rms)) * (2 if len(drifts) == 1 else 1)
    low, high = (float(drifts[label].end.rms) for label in (least, most))
    if len(drifts) > len(style.ROUTE_STYLES):
        return (
            f"of {len(drifts)} routes {most} drifts most, {_metric(high)} m rms at the end; the least {_metric(low)} m"
        )
    if len(drifts) == 1:
        return f"{least}: rms drift of {_metric(low)} m at the end"
    if not low < 0.995 * high:
        return f"all end with about the same drift, {_metric(low)} m rms"
    return f"{least}: {100 * (1 - low / high):.0f} % less drift at the end than {most}"


def _metric(value_m: float) -> str:
    """Three significant digits, and no more than millimetres need."""
    digits = 2 - floor(log10(abs(value_m))) if value_m else 0
    return f"{value_m:.{min(max(digits, 0), 4)}f}"
