"""Beacon layouts: on the map, as a sawtooth of drift against distance, as a trade-off curve, as importance bars; and
co-designs: their routes and beacons before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from driftplan.arrays import Floats, whole
from driftplan.report.figures import style
from driftplan.report.figures.maps import plot_beacons, plot_world
from driftplan.tables import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.container import BarContainer
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    from driftplan.layouts.co_design.design import CoDesign, Design
    from driftplan.layouts.layout import Layout
    from driftplan.world.world import World

_MAX_ROUTES = 5  # sawtooth lines with a style of their own; others are grey
_MAX_LABELS = 12  # routes that are named on the map
_MAX_BARS = 25
_NAME_SHARE = np.array([0.2, 0.06])  # of the map that the name of a route takes, about
_SPACING_M = 0.25
_BEACON_LABELS = ("new beacon", "existing beacon")


class LayoutArtists(NamedTuple):
    """What `plot_layout` drew."""

    routes: LineCollection
    ranges: list[Patch]
    beacons: list[Line2D]


def route_segments(layout: Layout) -> tuple[Floats, Floats]:
    """Short segments of all routes, (k, 2, 2) in metres, and the greatest drift on each, (k,), for `plot_layout`."""
    segments, values = [], []
    for drift in layout.drifts:
        profile = drift.profile(_SPACING_M)
        xy, score = profile.xy, layout.scenario.score(profile)
        segments.append(np.stack([xy[:-1], xy[1:]], axis=1))
        values.append(np.maximum(score[:-1], score[1:]))
    return np.concatenate(segments), np.concatenate(values)


def plot_layout(layout: Layout, *, ax: Axes | None = None, colorbar: bool = True, **line_kwargs: Any) -> LayoutArtists:
    """Draw a layout on its map: beacons with their ranges and ids, routes coloured by their drift.

    Up to twelve routes are named at their starts, with arrows the way they are driven. ``ax`` is pyplot's current Axes
    unless given; ``line_kwargs`` go to the routes' LineCollection untouched.

    >>> from matplotlib.figure import Figure
    >>> from driftplan import BeaconKind, OdometryNoise, place_beacons
    >>> noise, tag = OdometryNoise(heading_var_per_m=1e-3), BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> layout = place_beacons(None, [(0, 0), (10, 0)], noise, 0.5, tag)
    >>> [mark.get_label() for mark in plot_layout(layout, ax=Figure().subplots()).beacons]
    ['new beacon']
    """
    from matplotlib.collections import LineCollection

    ax = style.current_axes(ax)
    if layout.scenario.world is not None:
        plot_world(layout.scenario.world, ax=ax)
    segments, drift = route_segments(layout)
    order = np.argsort(drift)  # where routes share an aisle the worst is on top
    look: dict[str, Any] = {"cmap": _drift_colours(), "linewidths": 1.8, "capstyle": "round", "zorder": 2.5}
    look |= line_kwargs
    routes = LineCollection(list(segments[order]), **look)
    routes.set_array(drift[order])
    routes.set_clim(0.0, max(layout.max_drift))
    ax.add_collection(routes)
    if len(layout.drifts) <= _MAX_LABELS:
        box = map_box(layout)
        starts = np.array([drift.xy[0] for drift in layout.drifts])
        right_edge, room = np.array([0.1, 0.9]) @ box[:, 0], _NAME_SHARE * (box[1] - box[0])
        for r, start in enumerate(starts):
            style.arrow_along(ax, layout.drifts[r].xy, "black")
            beside = (np.abs(starts[:r] - start) < room).all(axis=1).sum() % 2  # names of near starts take turns
            side, offset = ("right", -5) if start[0] > right_edge else ("left", 5)
            style.name_at(ax, f"route {r}", start, (offset, 4 if beside else -9), ha=side, fontsize=8, weight="bold")
            ax.plot(*start, zorder=4, **{**style.START, "markersize": 6, "markeredgewidth": 1.5})
    beacons = plot_beacons(layout.everyone, ax=ax, used=layout.beacons, labels=_BEACON_LABELS)
    style.in_metres(ax)
    if layout.scenario.world is None:
        ax.autoscale_view()
    if colorbar:
        ax.figure.colorbar(routes, ax=ax, label=_score_label(layout), fraction=0.035, pad=0.02)
    return LayoutArtists(routes, beacons.ranges, beacons.marks)


def _drift_colours() -> Any:
    """From light green to almost black: the worst is the darkest, in grey too, and all of it shows on white."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["viridis_r"](np.linspace(0.15, 1.0, 256)), name="drift")


def plot_sawtooth(
    layout: Layout, *, routes: Sequence[int] | None = None, ax: Axes | None = None, **line_kwargs: Any
) -> list[Line2D]:
    """Draw drift against distance driven: it grows, and drops wherever a beacon is read, under the limit.

    Parameters
    ----------
    routes : which to draw with a style and a label; default: the five that come nearest to their limits, the others
        thin and grey
    **line_kwargs : go to the lines of ``routes`` untouched; these are returned, in order

    >>> from matplotlib.figure import Figure
    >>> from driftplan import BeaconKind, OdometryNoise, place_beacons
    >>> noise, tag = OdometryNoise(heading_var_per_m=1e-3), BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> layout = place_beacons(None, [(0, 0), (10, 0)], noise, 0.5, tag)
    >>> [line.get_label() for line in plot_sawtooth(layout, ax=Figure().subplots())]
    ['route 0']
    """
    ax = style.current_axes(ax)
    share = np.array(layout.worst_drifts) / np.array(layout.max_drift)
    chosen = list(np.argsort(-share, kind="stable")[:_MAX_ROUTES]) if routes is None else list(routes)
    if not all(whole("a route", r, least=0) < len(share) for r in chosen):
        raise ValueError(f"expected routes of {len(share)}, counted from 0, got {chosen}")
    lines: list[Line2D] = []
    for r in range(len(layout.drifts)) if routes is None else ():
        if r not in chosen:
            ax.plot(*_profile(layout, r), **style.OTHER_ROUTE)
    for r, own in zip(chosen, cycle(style.ROUTE_STYLES)):
        plain = {key: value for key, value in own.items() if key != "marker"}
        look = {"linewidth": 1.5, "zorder": 3, "label": f"route {r}", **plain, **line_kwargs}
        lines += ax.plot(*_profile(layout, int(r)), **look)
    for limit in sorted({layout.max_drift[int(r)] for r in chosen}):
        ax.axhline(limit, label=f"limit {limit:.3g} m", **style.LIMIT)
    ax.set(xlabel="distance driven (m)", ylabel=_score_label(layout))
    ax.set_xlim(left=0.0)
    ax.set_ylim(bottom=0.0)
    ax.legend(**style.LEGEND_ABOVE, ncols=3)
    return lines


def plot_tradeoff(curve: Sequence[Layout], *, ax: Axes | None = None, **line_kwargs: Any) -> Line2D:
    """Draw the worst drift that a number of beacons can hold, as from `driftplan.layouts.place.beacon_tradeoff`; points
    not proven to be the best are hollow.

    >>> from matplotlib.figure import Figure
    >>> from driftplan import BeaconKind, OdometryNoise, place_beacons
    >>> noise, tag = OdometryNoise(heading_var_per_m=1e-3), BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> layout = place_beacons(None, [(0, 0), (10, 0)], noise, 0.5, tag)
    >>> plot_tradeoff([layout], ax=Figure().subplots()).get_ydata().tolist()
    [1]
    """
    from matplotlib.ticker import MaxNLocator

    ax = style.current_axes(ax)
    if not curve:
        raise ValueError("expected a trade-off curve of at least one layout, got none")
    drift, count = np.array([x.worst_drift for x in curve]), np.array([len(x.beacons) for x in curve])
    look: dict[str, Any] = {"color": style.MANY_COLOURS[0], "linewidth": 1.5, "drawstyle": "steps-post", "zorder": 2}
    (line,) = ax.plot(drift[::-1], count[::-1], **look | line_kwargs)
    for proven, face in ((True, line.get_color()), (False, "white")):
        some = np.array([x.proven == proven for x in curve])
        if some.any():
            dots: dict[str, Any] = {"color": line.get_color(), "markerfacecolor": face, "zorder": 3, "clip_on": False}
            ax.plot(drift[some], count[some], "o", label="proven" if proven else "best found", **dots)
    ax.set(xlabel=f"limit on the {_score_label(curve[0])}", ylabel="fewest beacons")
    ax.set_ylim(bottom=0.0)
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    style.quiet_grid(ax)
    ax.legend(loc="upper right", fontsize=8)
    return line


def plot_importance(layout: Layout, *, ax: Axes | None = None, **bar_kwargs: Any) -> BarContainer:
    """Draw, for every beacon, the worst drift on any route if it alone is dead, and the limit.

    Beacons whose failure hurts most are on top; of more than 25 the others are left out.

    >>> from matplotlib.figure import Figure
    >>> from driftplan import BeaconKind, OdometryNoise, place_beacons
    >>> noise, tag = OdometryNoise(heading_var_per_m=1e-3), BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> layout = place_beacons(None, [(0, 0), (10, 0)], noise, 0.5, tag)
    >>> [round(float(bar.get_width()), 3) for bar in plot_importance(layout, ax=Figure().subplots())]
    [0.577]
    """
    ax = style.current_axes(ax)
    served = [x for x in layout.importance if x.routes]
    shown = sorted(served, key=lambda x: -x.worst_single_failure)[:_MAX_BARS]
    old = {b.id for b in layout.existing}
    colours = [style.OTHER_BEACON_COLOUR if x.beacon.id in old else style.BEACON_COLOUR for x in shown]
    look: dict[str, Any] = {"color": colours, "alpha": 0.85, **bar_kwargs}
    bars = ax.barh(np.arange(len(shown)), [x.worst_single_failure for x in shown], **look)
    ax.set_yticks(np.arange(len(shown)), [x.beacon.id for x in shown], fontsize=7)
    ax.invert_yaxis()
    limit = min(layout.max_drift)
    ax.axvline(limit, **style.LIMIT, label=f"limit {limit:.3g} m")
    ax.set(xlabel=f"{_score_label(layout)} if this beacon is dead", ylabel="beacon")
    ax.legend(**style.LEGEND_ABOVE)
    return bars


def layout_figure(layout: Layout, *, figure: Figure | None = None) -> Figure:
    """The layout on its map, the sawtooth of its routes and the importance of its beacons, in one figure.

    >>> from driftplan import BeaconKind, OdometryNoise, place_beacons
    >>> noise, tag = OdometryNoise(heading_var_per_m=1e-3), BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> layout = place_beacons(None, [(0, 0), (10, 0)], noise, 0.5, tag)
    >>> layout_figure(layout).axes[0].get_title()
    '1 beacon (proven fewest) keeps 1 route under 0.5 m; worst 0.467 m'
    """
    shape = _map_shape(layout)
    figure = style.new_figure(figure, 12.0, 12.0 * shape * 0.85 + 4.2)
    grid = figure.add_gridspec(2, 2, height_ratios=(12.0 * shape * 0.85, 3.6), width_ratios=(2.0, 1.0))
    on_map = figure.add_subplot(grid[0, :])
    plot_layout(layout, ax=on_map)
    keep = "keeps" if len(layout.beacons) == 1 else "keep"
    kept = f"{keep} {counted(len(layout.drifts), 'route')} under {max(layout.max_drift):.3g} m"
    on_map.set_title(f"{found_in_words(layout)} {kept}; worst {layout.worst_drift:.3g} m", fontsize=10)
    if on_map.get_legend_handles_labels()[0]:
        on_map.legend(loc="upper right", fontsize=8, framealpha=0.9)
    plot_sawtooth(layout, ax=figure.add_subplot(grid[1, 0]))
    bars = figure.add_subplot(grid[1, 1])
    if any(x.routes for x in layout.importance):
        plot_importance(layout, ax=bars)
    else:
        bars.set_axis_off()
    return figure


def layouts_figure(layouts: Mapping[str, Layout], *, figure: Figure | None = None) -> Figure:
    """Layouts for the same routes side by side, each on its map above its sawtooth: in an empty figure, by default a
    new one that knows nothing of pyplot.

    >>> from driftplan import BeaconKind, OdometryNoise, place_beacons
    >>> noise, tag = OdometryNoise(heading_var_per_m=1e-3), BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> layout = place_beacons(None, [(0, 0), (10, 0)], noise, 0.5, tag)
    >>> layouts_figure({"tags": layout}).axes[0].get_title()
    'tags: 1 beacon (proven fewest)'
    """
    first, *_ = layouts.values()
    height = 6.0 * _map_shape(first)
    figure = style.new_figure(figure, 6.3 * len(layouts) + 0.8, height + 3.8)
    maps, curves = figure.subplots(2, len(layouts), squeeze=False, sharey="row", height_ratios=(height, 3.0))
    for (name, layout), on_map, on_drift in zip(layouts.items(), maps, curves, strict=True):
        drawn = plot_layout(layout, ax=on_map, colorbar=False)
        on_map.set_title(f"{name}: {found_in_words(layout)}", fontsize=10)
        lines = plot_sawtooth(layout, routes=range(min(len(layout.drifts), _MAX_ROUTES)), ax=on_drift)
        on_drift.get_legend().remove()
    figure.colorbar(drawn.routes, ax=list(maps), label=_score_label(first), fraction=0.02, pad=0.01)
    style.legend_below(figure, [*lines, on_drift.lines[-1], *drawn.beacons])
    return figure


def tradeoff_figure(curve: Sequence[Layout], *, figure: Figure | None = None) -> Figure:
    """`plot_tradeoff` in a figure of its own."""
    figure = style.new_figure(figure, 7.0, 4.5)
    plot_tradeoff(curve, ax=(ax := figure.subplots()))
    least, most = min(curve, key=lambda x: x.worst_drift), max(curve, key=lambda x: x.worst_drift)
    count = counted(len(least.beacons), "beacon")
    ax.set_title(f"{count}: {least.worst_drift:.3g} m instead of {most.worst_drift:.3g} m", fontsize=10)
    return figure


def _profile(layout: Layout, route: int) -> tuple[Floats, Floats]:
    profile = layout.drifts[route].profile(_SPACING_M)
    return profile.distance, layout.scenario.score(profile)


def map_box(layout: Layout) -> Floats:
    """Lower left and upper right corner of what is drawn, (2, 2)."""
    if layout.scenario.world is not None:
        return np.reshape(layout.scenario.world.bounds, (2, 2))
    xy = np.concatenate([drift.xy for drift in layout.drifts])
    return np.stack([xy.min(axis=0), xy.max(axis=0)])


def _map_shape(layout: Layout) -> float:
    """Its height over its width, within what a figure can have."""
    width, height = np.diff(map_box(layout), axis=0)[0].tolist()
    return float(min(max(height / max(width, 1e-9), 0.25), 1.5))


def found_in_words(layout: Layout) -> str:
    """How many beacons there are, and what is proven about that."""
    cost = "" if layout.cost == len(layout.beacons) else f" of cost {layout.cost:g}"
    proof = "proven fewest" if layout.proven else f"at least {layout.lower_bound:g} needed"
    return f"{counted(len(layout.beacons), 'beacon')}{cost} ({proof})"


def _score_label(layout: Layout) -> str:
    confidence = layout.scenario.confidence
    return "rms drift (m)" if confidence is None else f"{100 * confidence:g} % radius (m)"


def draw_design(world: World, design: Design, *, ax: Axes) -> list[Line2D]:
    """Draw the routes of a design and its beacons with their ranges.

    Returns list of Line2D: the routes, one per trip; starts and goals; the beacons. All are labelled for a legend.
    """
    plot_world(world, ax=ax)
    beacons = plot_beacons(design.layout.everyone, ax=ax, used=design.beacons, labels=_BEACON_LABELS)
    lines: list[Line2D] = []
    for k, (path, own) in enumerate(zip(design.paths, cycle(style.ROUTE_STYLES), strict=False)):
        look: dict[str, Any] = {"linewidth": 1.8, "label": f"trip {k}", **own, "markersize": 3.5, "zorder": 2.5}
        lines += ax.plot(*path.T, **look)
        style.arrow_along(ax, path, own["color"])
    lines += style.mark_ends(ax, design.paths)
    title = f"{counted(len(design.beacons), 'beacon')}, {sum(design.lengths):.4g} m of routes: cost {design.cost:.5g}"
    ax.set_title(title, fontsize=10)
    return [*lines, *beacons.marks]


def plot_design(world: World, found: CoDesign, *, figure: Figure | None = None) -> Figure:
    """Shortest routes with the beacons placed for them, and beside it routes and beacons chosen together.

    >>> from driftplan import BeaconKind, OdometryNoise, World, co_design
    >>> hall = World.from_polygons([], bounds=(0, 0, 40, 4), robot_radius=0.5)
    >>> noise, sign = OdometryNoise(heading_var_per_m=2e-4), BeaconKind.landmark(2.0, 0.05, 0.01, cost=100.0)
    >>> found = co_design(hall, [((2, 2), (38, 2))], noise, 1.2, sign, price_per_m=1.0, max_nodes=20)
    >>> plot_design(hall, found).axes[1].get_title()
    'chosen together\\n1 beacon, 36 m of routes: cost 136'
    """
    designs = [("shortest routes, then beacons", found.baseline), ("chosen together", found)]
    shown = [(name, design) for name, design in designs if design is not None]
    xmin, ymin, xmax, ymax = world.bounds
    height = 1.4 + min(max(5.6 * (ymax - ymin) / (xmax - xmin), 2.0), 8.0)
    figure = style.new_figure(figure, 6.3 * len(shown), height)
    for ax, (name, design) in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
        keys = draw_design(world, design, ax=ax)
        ax.set_title(f"{name}\n{ax.get_title()}", fontsize=10)
    style.legend_below(figure, keys)
    return figure
