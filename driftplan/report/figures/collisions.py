"""The figure of a chance of collision: where on the map, and how it adds up on the way."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from driftplan.report.figures import style
from driftplan.report.figures.maps import plot_world

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from driftplan.planning.collision_chance import CollisionChance
    from driftplan.world.world import World


def plot_collisions(world: World, chance: CollisionChance, *, figure: Figure | None = None) -> Figure:
    """The route on the map, the darker the likelier the robot is in a wall there, and that chance against the distance
    with the share of simulated drives that have touched a wall by then.

    Parameters
    ----------
    figure : an empty figure to draw into; default: a new one that knows nothing of pyplot

    >>> from driftplan import OdometryNoise, World, collision_chance, predict_drift
    >>> world = World.from_polygons([[(0, 2), (9, 2), (9, 3), (0, 3)]], bounds=(0, -9, 9, 3), robot_radius=0.5)
    >>> drift = predict_drift([(1, 1), (8, 1)], OdometryNoise(lateral_var_per_m=0.01))
    >>> len(plot_collisions(world, collision_chance(drift, world)).axes)
    3
    """
    from matplotlib.collections import LineCollection

    figure, on_map, on_curve = style.map_and_curve(figure, world.bounds)
    drawn = plot_world(world, ax=on_map)
    on_map.plot(*chance.xy.T, color="black", linewidth=5.5, solid_capstyle="round", zorder=2.9)
    ways = np.stack([chance.xy[:-1], chance.xy[1:]], axis=1)
    greater = np.maximum(chance.at[:-1], chance.at[1:])
    line = on_map.add_collection(LineCollection(list(ways), array=greater, cmap="YlOrRd", linewidths=4, zorder=3))
    line.set_clim(0.0, max(float(greater.max()), 1e-6))
    figure.colorbar(line, ax=on_map, label="chance of being in a wall there", shrink=0.7)
    worst = int(chance.at.argmax())
    on_map.annotate(f"{100 * chance.at[worst]:.2g} %", chance.xy[worst], (9, 9), textcoords="offset points", zorder=5)
    on_map.set_title(
        f"{100 * chance.probability:.3g} % of {chance.runs} drives touch a wall (95 %: {100 * chance.low:.2g} to "
        f"{100 * chance.high:.2g} %)",
        fontsize=10,
    )
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
