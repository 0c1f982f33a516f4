"""Drift against the distance driven."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from driftplan.arrays import number
from driftplan.report.figures import style
from driftplan.report.figures.maps import drift_of, mark_spacing_of, marked_profile

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

    from driftplan.model.drift import Drift
    from driftplan.planning.routes import Route


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

    Returns
    -------
    list of Line2D
        The rms, and the radius if asked for.

    >>> from matplotlib.figure import Figure
    >>> from driftplan import OdometryNoise, predict_drift
    >>> drift = predict_drift([(0, 0), (3, 0), (3, 1)], OdometryNoise(heading_var_per_m=1e-4))
    >>> [line.get_label() for line in plot_drift(drift, ax=Figure().subplots(), label="mine", radius_at=0.95)]
    ['mine', '95 % within this radius']
    """
    ax = style.current_axes(ax)
    drift = drift_of(route)
    profile, marks = marked_profile(drift, mark_spacing_of([drift], spacing_m))
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
