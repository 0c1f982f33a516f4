"""One visual language for all figures: what is drawn in which colour, marker and line, and on which panels.

Line styles and markers differ as well as colours, so that figures survive a black and white printer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Ellipse

ROUTE_STYLES: tuple[dict[str, Any], ...] = (  # told apart by the colour-blind, and in grey by how dark they are
    {"color": "#0B55B0", "linestyle": "-", "marker": "o"},
    {"color": "#D04A10", "linestyle": "--", "marker": "s"},
    {"color": "#10A67B", "linestyle": "-.", "marker": "^"},
    {"color": "#000000", "linestyle": ":", "marker": "D"},
    {"color": "#5C1060", "linestyle": (0, (6, 1, 1, 1, 1, 1)), "marker": "v"},
)
MANY_COLOURS = (*(own["color"] for own in ROUTE_STYLES), "#8D0F29", "#AC4B98", "#87B0F3", "#97BD71")
OTHER_ROUTE: dict[str, Any] = {"color": "0.6", "linewidth": 0.8, "zorder": 1.2}
OBSTACLE: dict[str, Any] = {"facecolor": "0.80", "edgecolor": "0.45", "linewidth": 0.5}
ZONE: dict[str, Any] = {"facecolor": "none", "edgecolor": "0.5", "linewidth": 0.8, "hatch": "///"}
START: dict[str, Any] = {"marker": "o", "markersize": 9, "markeredgewidth": 2}
START |= {"markerfacecolor": "white", "markeredgecolor": "black"}
GOAL: dict[str, Any] = {"marker": "*", "markersize": 15, "markeredgewidth": 0.8}
GOAL |= {"markerfacecolor": "black", "markeredgecolor": "white"}
BEACON_COLOUR, OTHER_BEACON_COLOUR = "#5A4000", "#555555"
BEACON: dict[str, Any] = {"marker": "^", "markersize": 7, "color": BEACON_COLOUR}
OTHER_BEACON: dict[str, Any] = {"marker": "s", "markersize": 5, "color": OTHER_BEACON_COLOUR}
RANGE: dict[str, Any] = {"facecolor": ("#E69F00", 0.3), "edgecolor": BEACON_COLOUR}
OTHER_RANGE: dict[str, Any] = {"facecolor": "none", "edgecolor": OTHER_BEACON_COLOUR, "linestyle": ":"}
LIMIT: dict[str, Any] = {"color": "#B00020", "linestyle": (0, (5, 2)), "linewidth": 1.2, "zorder": 2}
LEGEND_ABOVE: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "frameon": False, "fontsize": 8}
_MAP_AREA = 30.0  # square inches


def current_axes(ax: Axes | None) -> Axes:
    """These Axes, or pyplot's."""
    if ax is not None:
        return ax
    from matplotlib import pyplot

    return pyplot.gca()


def new_figure(figure: Figure | None, width: float, height: float) -> Figure:
    """The figure handed in, or one of this size in inches that knows nothing of pyplot."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained", dpi=150) if figure is None else figure


def map_and_curve(figure: Figure | None, box: Sequence[float]) -> tuple[Figure, Axes, Axes]:
    """A panel for the map, as large as the shape of its box allows, and one for a curve: beside it or below it."""
    shape = (box[3] - box[1]) / (box[2] - box[0])
    beside = shape > 0.4
    width = (_MAP_AREA / min(shape, 1.9)) ** 0.5 if beside else 10.5
    height = width * min(max(shape, 0.1), 1.9)
    if beside:
        figure = new_figure(figure, width + 5.4, height + 2.0)
        on_map, on_curve = figure.subplots(1, 2, width_ratios=(width, 4.0))
        on_curve.set_box_aspect(height / 4.0)  # as high as the map
    else:
        figure = new_figure(figure, 11.5, height + 5.4)
        on_map, on_curve = figure.subplots(2, 1, height_ratios=(height, 3.2))
    on_map.set(xlim=(box[0], box[2]), ylim=(box[1], box[3]))
    return figure, on_map, on_curve


def own_look(ax: Axes, given: dict[str, Any]) -> dict[str, Any]:
    """A route's look: as given, or by default the first of `ROUTE_STYLES` whose colour these Axes do not have yet."""
    taken = {line.get_color() for line in ax.lines}
    free = next((own for own in ROUTE_STYLES if own["color"] not in taken), ROUTE_STYLES[0])
    return {**({} if "color" in given else free), **given}


def in_metres(ax: Axes) -> None:
    """Axes of a map."""
    ax.set_aspect("equal", adjustable="box")
    ax.set(xlabel="x (m)", ylabel="y (m)")


def arrow_along(ax: Axes, xy: Any, colour: Any) -> None:
    """An arrow half-way along a polyline (n, 2): which way it is driven."""
    step = np.hypot(*np.diff(xy, axis=0).T)
    if not step.sum() > 0:
        return
    leg = int(np.searchsorted(np.cumsum(step), 0.5 * step.sum()))
    middle, ahead = (xy[leg] + xy[leg + 1]) / 2, (xy[leg + 1] - xy[leg]) / step[leg]
    head: dict[str, Any] = {"arrowstyle": "-|>", "color": colour, "mutation_scale": 16, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", middle + 1e-3 * step.sum() * ahead, middle, arrowprops=head, zorder=3.5, annotation_clip=True)


def name_at(ax: Axes, name: str, xy: Any, offset: tuple[float, float], **look: Any) -> None:
    """A name beside a place, in points from it, legible on whatever line is below."""
    from matplotlib.patheffects import withStroke

    halo = [withStroke(linewidth=2.0, foreground="white")]
    ax.annotate(name, xy, offset, textcoords="offset points", path_effects=halo, **{"zorder": 5, **look})


def mark_ends(ax: Axes, paths: Sequence[Any]) -> list[Line2D]:
    """Where polylines (n, 2) start and where they end, labelled for a legend."""
    return [
        *ax.plot(*np.array([path[0] for path in paths]).T, linestyle="none", zorder=4, label="start", **START),
        *ax.plot(*np.array([path[-1] for path in paths]).T, linestyle="none", zorder=4, label="goal", **GOAL),
    ]


def quiet_grid(ax: Axes) -> None:
    """A grid that does not compete with what is drawn."""
    ax.grid(visible=True, which="major", color="0.9", linewidth=0.6)
    ax.set_axisbelow(True)


def legend_below(figure: Figure, handles: Sequence[Any]) -> None:
    """One legend for all panels, outside them, in as many columns as its labels leave room for."""
    from matplotlib.legend_handler import HandlerPatch
    from matplotlib.patches import Ellipse

    def small_ellipse(*, width: float, height: float, xdescent: float, ydescent: float, **_: Any) -> Ellipse:
        return Ellipse(((width - xdescent) / 2, (height - ydescent) / 2), width, 1.3 * height)

    labels = [str(handle.get_label()) for handle in handles]
    inches = 0.7 + 0.075 * max(map(len, labels))  # of a column, generously
    columns = max(min(int(figure.get_figwidth() / inches), 4, len(labels)), 1)
    look: dict[str, Any] = {"ncols": columns, "frameon": False, "handlelength": 3.2}
    look["handler_map"] = {Ellipse: HandlerPatch(patch_func=small_ellipse)}
    figure.legend(handles=list(handles), labels=labels, loc="outside lower center", **look)
