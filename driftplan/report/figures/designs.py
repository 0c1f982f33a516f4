"""The figure of a co-design: routes and beacons before and after, and what they cost."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

from driftplan.report.figures import style
from driftplan.report.figures.maps import plot_beacons, plot_world
from driftplan.tables import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from driftplan.layouts.co_design.design import CoDesign, Design
    from driftplan.world.world import World


def draw_design(world: World, design: Design, *, ax: Axes) -> list[Line2D]:
    """Draw the routes of a design and its beacons with their ranges.

    Returns
    -------
    list of Line2D
        The routes, one per trip; starts and goals; the beacons. All are labelled for a legend.
    """
    plot_world(world, ax=ax)
    everyone = (*design.layout.existing, *design.beacons)
    beacons = plot_beacons(everyone, ax=ax, used=design.beacons, labels=("new beacon", "existing beacon"))
    lines: list[Line2D] = []
    for k, (path, own) in enumerate(zip(design.paths, cycle(style.ROUTE_STYLES), strict=False)):
        look: dict[str, Any] = {"linewidth": 1.8, "label": f"trip {k}", **own, "markersize": 3.5, "zorder": 2.5}
        lines += ax.plot(*path.T, **look)
        style.arrow_along(ax, path, own["color"])
    lines += style.mark_ends(ax, design.paths)
    ax.set_title(
        f"{counted(len(design.beacons), 'beacon')}, {sum(design.lengths):.4g} m of routes: cost {design.cost:.5g}",
        fontsize=10,
    )
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
    keys: list[Line2D] = []
    for ax, (name, design) in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
        keys = draw_design(world, design, ax=ax)
        ax.set_title(f"{name}\n{ax.get_title()}", fontsize=10)
    style.legend_below(figure, keys)
    return figure
