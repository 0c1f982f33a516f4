"""The figure of a co-design: routes and beacons before and after, and what they cost."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

from driftplan.report.plotting import ROUTE_STYLES, plot_world

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from driftplan.layouts.co_design.design import CoDesign, Design
    from driftplan.world.world import World

_NEW: dict[str, Any] = {"facecolor": "#E69F00", "edgecolor": "#8A5F00", "alpha": 0.45, "linewidth": 0.9}
_OLD: dict[str, Any] = {"facecolor": "none", "edgecolor": "0.4", "linestyle": ":", "linewidth": 1.0}


def draw_design(world: World, design: Design, *, ax: Axes) -> list[Line2D]:
    """Draw the routes of a design and its beacons with their ranges.

    Returns
    -------
    list of Line2D
        The routes, one per trip.
    """
    from matplotlib.patches import Circle

    plot_world(world, ax=ax)
    for beacons, look in ((design.layout.existing, _OLD), (design.beacons, _NEW)):
        for beacon in beacons:
            ax.add_patch(Circle((beacon.x, beacon.y), beacon.kind.range_m, zorder=1.5, **look))
            ax.plot([beacon.x], [beacon.y], "x", color=look["edgecolor"], markersize=5, zorder=3)
    lines: list[Line2D] = []
    for k, (path, style) in enumerate(zip(design.paths, cycle(ROUTE_STYLES), strict=False)):
        look = {"linewidth": 1.8, "label": f"trip {k}", **style, "markersize": 3.5, "zorder": 2.5}
        lines += ax.plot(*path.T, **look)
        ax.plot(*path[0], "o", markersize=8, markerfacecolor="none", markeredgecolor=style["color"], zorder=3)
    number, driven = len(design.beacons), sum(design.lengths)
    ax.set_title(
        f"{number} beacon{'' if number == 1 else 's'}, {driven:.4g} m of routes: cost {design.cost:.5g}", fontsize=10
    )
    xmin, ymin, xmax, ymax = world.bounds
    ax.set(xlim=(xmin, xmax), ylim=(ymin, ymax), xlabel="x (m)", ylabel="y (m)")
    ax.set_aspect("equal", adjustable="box")
    return lines


def plot_design(world: World, found: CoDesign, *, figure: Figure | None = None) -> Figure:
    """Shortest routes with the beacons placed for them, and beside it routes and beacons chosen together.

    Parameters
    ----------
    world : World
    found : CoDesign
    figure : Figure, optional
        An empty one to draw into; default: a new one that knows nothing of pyplot.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    designs = [("shortest routes, then beacons", found.baseline), ("chosen together", found)]
    shown = [(name, design) for name, design in designs if design is not None]
    xmin, ymin, xmax, ymax = world.bounds
    if figure is None:
        height = 1.4 + min(max(5.6 * (ymax - ymin) / (xmax - xmin), 2.0), 8.0)
        figure = Figure(figsize=(6.3 * len(shown), height), layout="constrained", dpi=150)
    lines: list[Line2D] = []
    for ax, (name, design) in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
        lines = draw_design(world, design, ax=ax)
        ax.set_title(f"{name}\n{ax.get_title()}", fontsize=10)
    start = Line2D(
        [], [], marker="o", markersize=8, markerfacecolor="none", color="0.3", linestyle="none", label="start"
    )
    keys: list[Any] = [*lines, start, Patch(label="range of a new beacon", **_NEW)]
    if found.layout.existing:
        keys.append(Patch(label="range of an existing beacon", **_OLD))
    figure.legend(handles=keys, loc="outside lower center", ncols=min(len(keys), 8), frameon=False, fontsize=8)
    return figure
