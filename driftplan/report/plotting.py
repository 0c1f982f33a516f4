"""Maps, routes, error ellipses and drift against distance, drawn on the Axes you hand in.

Numbers are computed apart from drawing, artists are returned, nothing is shown or saved, and no global setting of
matplotlib is touched. Line styles and markers differ as well as colours, so the figures survive a black and white
printer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from math import floor, hypot, log10
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from driftplan.arrays import Floats
from driftplan.model.drift import Drift, PointDrift
from driftplan.report.ellipses import error_ellipse, magnification, mark_distances, mark_spacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    from driftplan.planning.routes import Route
    from driftplan.world.world import World


ROUTE_STYLES: tuple[dict[str, Any], ...] = (  # colours of Okabe and Ito, told apart by the colour-blind too
    {"color": "#0072B2", "linestyle": "-", "marker": "o"},
    {"color": "#D55E00", "linestyle": "--", "marker": "s"},
    {"color": "#009E73", "linestyle": "-.", "marker": "^"},
    {"color": "#000000", "linestyle": ":", "marker": "D"},
    {"color": "#AA4499", "linestyle": (0, (6, 1, 1, 1, 1, 1)), "marker": "v"},
)
_OBSTACLE: dict[str, Any] = {"facecolor": "0.80", "edgecolor": "0.45", "linewidth": 0.5}
_ZONE: dict[str, Any] = {"facecolor": "none", "edgecolor": "0.5", "linewidth": 0.8, "hatch": "///"}
_START: dict[str, Any] = {
    "marker": "o",
    "markersize": 9,
    "markerfacecolor": "white",
    "markeredgecolor": "black",
    "markeredgewidth": 2,
}
_GOAL: dict[str, Any] = {
    "marker": "*",
    "markersize": 15,
    "markerfacecolor": "black",
    "markeredgecolor": "white",
    "markeredgewidth": 0.8,
}
_MAP_AREA = 30.0  # square inches
_SAMPLES_PER_MARK = 20  # points of a drift curve between two marks: smooth, and every mark is one of them


class WorldArtists(NamedTuple):
    """What `plot_world` drew."""

    obstacles: Patch | None
    zones: list[Patch]


class RouteArtists(NamedTuple):
    """What `plot_route` drew."""

    line: Line2D
    ellipses: list[Patch]
    start: Line2D
    goal: Line2D


def plot_world(world: World, *, ax: Axes | None = None, **obstacle_kwargs: Any) -> WorldArtists:
    """Draw a map: obstacles as drawn (not inflated), zones hatched, axes in metres and of equal scale.

    Parameters
    ----------
    world : World
    ax : Axes, optional
        Default: pyplot's current Axes.
    **obstacle_kwargs
        Go to the obstacles' patch untouched.
    """
    from shapely.plotting import patch_from_polygon

    ax = _current_axes() if ax is None else ax
    obstacles = None
    if not world.obstacles.is_empty:
        look = {**_OBSTACLE, "label": "obstacle", "zorder": 1, **obstacle_kwargs}
        obstacles = ax.add_patch(patch_from_polygon(world.obstacles, **look))
    zones = []
    for i, zone in enumerate(world.zones):
        label = "zone with odometry of its own" if i == 0 else "_nolegend_"
        zones.append(ax.add_patch(patch_from_polygon(zone.polygon, **_ZONE, label=label, zorder=0.9)))
    xmin, ymin, xmax, ymax = world.bounds
    ax.set(xlim=(xmin, xmax), ylim=(ymin, ymax))
    _metres(ax)
    return WorldArtists(obstacles, zones)


def plot_route(
    route: Route | Drift,
    *,
    ax: Axes | None = None,
    label: str | None = None,
    confidence: float = 0.95,
    spacing_m: float | None = None,
    magnify: float | None = None,
    **line_kwargs: Any,
) -> RouteArtists:
    """Draw a route, its start and goal, and at regular distances the ellipse in which the robot will think it is.

    An ellipse holds the estimated position with the given confidence (Gaussian approximation). It is centred on the
    true position plus the bias; enlarged by ``magnify``, so is the bias.

    Parameters
    ----------
    route : Route or Drift
    ax : Axes, optional
        Default: pyplot's current Axes.
    label : str, optional
        Of the line in a legend.
    confidence : float
    spacing_m : float, optional
        Metres between ellipses; default: a round number that gives about 8. The end always has one.
    magnify : float, optional
        Enlargement of the ellipses, told in the legend; default: as much as it takes to see them (`magnification`).
    **line_kwargs
        Go to the line untouched; ellipses take its colour.
    """
    from matplotlib.patches import Ellipse

    ax = _current_axes() if ax is None else ax
    drift = _drift_of(route)
    spacing = _spacing([drift], spacing_m)
    profile, marks = _marked_profile(drift, spacing)
    if magnify is None:
        magnify = magnification([drift], _diagonal(_box_around(profile.xy)), confidence)
    if not magnify > 0:
        raise ValueError(f"expected magnify > 0, got {magnify!r}")
    look = {"linewidth": 1.8, "markersize": 4, "zorder": 3, "label": label, **line_kwargs}
    (line,) = ax.plot(profile.xy[:, 0], profile.xy[:, 1], markevery=marks, **look)
    at = PointDrift(profile.distance[marks], profile.moments[np.asarray(marks)])
    centre = at.xy + magnify * at.bias
    said = _ellipse_label(confidence, spacing, magnify)
    ellipses = [
        ax.add_patch(
            Ellipse(
                (x, y),
                magnify * width,
                magnify * height,
                angle=angle,
                facecolor=(*_rgb(line), 0.12),
                edgecolor=(*_rgb(line), 0.9),
                linestyle=line.get_linestyle() if "linestyle" in line_kwargs else "-",
                linewidth=0.9,
                label=said if i == 0 else "_nolegend_",
                zorder=2,
            )
        )
        for i, (x, y, width, height, angle) in enumerate(
            zip(*centre.T, *error_ellipse(at.cov, confidence), strict=True)
        )
    ]
    ends: dict[str, Any] = {"linestyle": "none", "zorder": 4}
    (start,) = ax.plot(*profile.xy[0], **_START, **ends, label="start")
    (goal,) = ax.plot(*profile.xy[-1], **_GOAL, **ends, label="goal")
    _metres(ax)
    return RouteArtists(line, ellipses, start, goal)


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
    route : Route or Drift
    ax : Axes, optional
        Default: pyplot's current Axes.
    label : str, optional
    spacing_m : float, optional
        Metres between marks; default as in `plot_route`.
    radius_at : float, optional
        Draw, thin, the radius that holds the estimate with this confidence too.
    **line_kwargs
        Go to the rms line untouched.

    Returns
    -------
    list of Line2D
        The rms, and the radius if asked for.
    """
    ax = _current_axes() if ax is None else ax
    drift = _drift_of(route)
    profile, marks = _marked_profile(drift, _spacing([drift], spacing_m))
    look = {"linewidth": 1.8, "markersize": 4, "label": label, **line_kwargs}
    lines = ax.plot(profile.distance, profile.rms, markevery=marks, **look)
    if radius_at is not None:
        said = f"{100 * radius_at:g} % within this radius"
        thin: dict[str, Any] = {"color": lines[0].get_color(), "linestyle": (0, (1, 1.5)), "linewidth": 1.2}
        lines += ax.plot(profile.distance, profile.radius(radius_at), label=said, **thin)
    ax.set(xlabel="distance driven (m)", ylabel="rms drift (m)" if radius_at is None else "drift (m)")
    ax.update_datalim([(0.0, 0.0)])
    for line in lines:  # no margin below zero; limits stay automatic, for whatever is drawn next
        line.sticky_edges.x.append(0.0)
        line.sticky_edges.y.append(0.0)
    ax.autoscale_view()
    ax.grid(visible=True, color="0.9", linewidth=0.6)
    ax.set_axisbelow(True)
    return list(lines)


def plot_comparison(
    world: World | None, routes: Mapping[str, Route | Drift], *, figure: Figure | None = None, confidence: float = 0.95
) -> Figure:
    """Routes on the map with their error ellipses, and beside it their rms drift against the distance driven.

    Parameters
    ----------
    world : World or None
        None: no map is drawn, the view is that of the routes.
    routes : mapping of label to Route or Drift
    figure : Figure, optional
        An empty figure to draw into, such as ``pyplot.figure(layout="constrained")``; default: a new one that knows
        nothing of pyplot.
    confidence : float
        Of the error ellipses.
    """
    if not routes:
        raise ValueError("expected at least one route to draw, got none")
    drifts = {label: _drift_of(route) for label, route in routes.items()}
    spacing = _spacing(list(drifts.values()), None)
    box = _box_around(*(d.profile().xy for d in drifts.values())) if world is None else world.bounds
    magnify = magnification(list(drifts.values()), _diagonal(box), confidence)
    figure, on_map, on_drift = _panels(figure, box)
    on_map.set(xlim=(box[0], box[2]), ylim=(box[1], box[3]))
    drawn_world = plot_world(world, ax=on_map) if world is not None else WorldArtists(None, [])
    drawn: list[RouteArtists] = []
    handles: list[Any] = []
    for (label, drift), style in zip(drifts.items(), cycle(ROUTE_STYLES)):
        drawn.append(plot_route(drift, ax=on_map, magnify=magnify, spacing_m=spacing, confidence=confidence, **style))
        said = f"{label}: {_metric(float(drift.length))} m, rms {_metric(float(drift.end.rms))} m at the end"
        handles += plot_drift(drift, ax=on_drift, label=said, spacing_m=spacing, **style)
    handles += [drawn[0].start, drawn[0].goal, drawn[0].ellipses[0]]
    handles += [patch for patch in (drawn_world.obstacles, *drawn_world.zones[:1]) if patch is not None]
    _legend_below(figure, handles)
    return figure


# Details


def _panels(figure: Figure | None, box: Sequence[float]) -> tuple[Figure, Axes, Axes]:
    """A figure with a panel for the map, as large as its shape allows, and one for the drift: beside it or below it."""
    from matplotlib.figure import Figure

    shape = (box[3] - box[1]) / (box[2] - box[0])
    beside = shape > 0.4
    width = (_MAP_AREA / min(shape, 1.9)) ** 0.5 if beside else 10.5
    height = width * min(max(shape, 0.1), 1.9)
    if figure is None:
        size = (width + 5.4, height + 2.0) if beside else (11.5, height + 5.4)
        figure = Figure(figsize=size, layout="constrained", dpi=150)
    if beside:
        on_map, on_drift = figure.subplots(1, 2, width_ratios=(width, 4.0))
        on_drift.set_box_aspect(height / 4.0)  # as high as the map
    else:
        on_map, on_drift = figure.subplots(2, 1, height_ratios=(height, 3.2))
    return figure, on_map, on_drift


def _legend_below(figure: Figure, handles: list[Any]) -> None:
    """One legend for both panels, outside them."""
    from matplotlib.legend_handler import HandlerPatch
    from matplotlib.patches import Ellipse

    def small_ellipse(
        legend: Any, orig_handle: Any, xdescent: float, ydescent: float, width: float, height: float, fontsize: float
    ) -> Ellipse:
        return Ellipse(((width - xdescent) / 2, (height - ydescent) / 2), width, 1.3 * height)

    labels = [str(handle.get_label()) for handle in handles]
    inches = 0.7 + 0.075 * max(map(len, labels))  # of a column, generously
    figure.legend(
        handles=handles,
        labels=labels,
        loc="outside lower center",
        ncols=2 if 2 * inches < figure.get_figwidth() else 1,
        frameon=False,
        handlelength=3.2,
        handler_map={Ellipse: HandlerPatch(patch_func=small_ellipse)},
    )


def _drift_of(route: Route | Drift) -> Drift:
    return route if isinstance(route, Drift) else route.drift


def _spacing(drifts: Sequence[Drift], spacing_m: float | None) -> float:
    if spacing_m is None:
        return mark_spacing(max(float(drift.length) for drift in drifts))
    if not spacing_m > 0:
        raise ValueError(f"expected spacing_m > 0, got {spacing_m!r}")
    return spacing_m


def _marked_profile(drift: Drift, spacing_m: float) -> tuple[PointDrift, list[int]]:
    """The drift in small steps, and which of them are the marks."""
    profile = drift.profile(spacing_m / _SAMPLES_PER_MARK)
    marks = mark_distances(float(drift.length), spacing_m)
    return profile, [int(np.searchsorted(profile.distance, s * (1 + 1e-9), side="right")) - 1 for s in marks]


def _box_around(*lines: Floats) -> tuple[float, float, float, float]:
    """Bounds of polylines with a margin of a tenth, and never thinner than a fifth of their greater side."""
    xy = np.concatenate(lines)
    low, high = xy.min(axis=0), xy.max(axis=0)
    side = float((high - low).max()) or 1.0
    half = np.maximum((high - low) / 2 + 0.1 * side, 0.2 * side)
    middle = (low + high) / 2
    (xmin, ymin), (xmax, ymax) = (middle - half).tolist(), (middle + half).tolist()
    return xmin, ymin, xmax, ymax


def _diagonal(box: Sequence[float]) -> float:
    return hypot(box[2] - box[0], box[3] - box[1])


def _ellipse_label(confidence: float, spacing_m: float, magnify: float) -> str:
    scale = "" if magnify == 1 else f", drawn {magnify:g} × its size"
    return f"{100 * confidence:g} % error ellipse every {spacing_m:g} m{scale}"


def _metric(value_m: float) -> str:
    """Three significant digits, and no more than millimetres need."""
    digits = 2 - floor(log10(abs(value_m))) if value_m else 0
    return f"{value_m:.{min(max(digits, 0), 4)}f}"


def _rgb(line: Line2D) -> tuple[float, float, float]:
    from matplotlib.colors import to_rgb

    return to_rgb(line.get_color())


def _metres(ax: Axes) -> None:
    ax.set_aspect("equal", adjustable="box")
    ax.set(xlabel="x (m)", ylabel="y (m)")


def _current_axes() -> Axes:
    from matplotlib import pyplot

    return pyplot.gca()
