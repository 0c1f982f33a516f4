"""What is seen from above: worlds, routes with their error ellipses (shape, places, magnification), beacons."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, hypot, log, log10
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, positive
from driftplan.model.drift import Drift
from driftplan.model.point_drift import PointDrift
from driftplan.report.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    from driftplan.beacons.beacon import Beacon
    from driftplan.planning.routes import Route
    from driftplan.world.world import World

_SAMPLES_PER_MARK = 20  # points of a drift curve between two marks: smooth, and every mark is one of them
_MAX_IDS = 40  # with more beacons on a map their names would cover each other


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

    >>> from matplotlib.figure import Figure
    >>> from driftplan import World
    >>> world = World.from_polygons([[(2, 0), (3, 0), (3, 4), (2, 4)]], bounds=(0, 0, 5, 4), robot_radius=0.4)
    >>> plot_world(world, ax=Figure().subplots()).obstacles.get_label()
    'obstacle'
    """
    from shapely.plotting import patch_from_polygon

    ax = style.current_axes(ax)
    obstacles = None
    if not world.obstacles.is_empty:
        look = {**style.OBSTACLE, "label": "obstacle", "zorder": 1, **obstacle_kwargs}
        obstacles = ax.add_patch(patch_from_polygon(world.obstacles, **look))
    zones: list[Patch] = []
    for zone in world.zones:
        label = "_nolegend_" if zones else "zone with odometry of its own"
        zones.append(ax.add_patch(patch_from_polygon(zone.polygon, **style.ZONE, label=label, zorder=0.9)))
    ax.set(xlim=world.bounds[::2], ylim=world.bounds[1::2])
    style.in_metres(ax)
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
    label : of the line in a legend
    spacing_m : metres between ellipses; default: a round number that gives about 8. The end always has one.
    magnify : enlargement of the ellipses, told in the legend; default: as much as it takes to see them
        (`magnification`)

    >>> from matplotlib.figure import Figure
    >>> from driftplan import OdometryNoise, predict_drift
    >>> drift = predict_drift([(0, 0), (3, 0), (3, 1)], OdometryNoise(heading_var_per_m=1e-4))
    >>> plot_route(drift, ax=Figure().subplots(), magnify=2).ellipses[0].get_label()
    '95 % error ellipse every 0.5 m, drawn 2 × its size'
    """
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Ellipse

    ax = style.current_axes(ax)
    drift = drift_of(route)
    spacing = mark_spacing_of([drift], spacing_m)
    profile, marks = marked_profile(drift, spacing)
    if magnify is None:
        magnify = magnification([drift], diagonal(box_around(profile.xy)), confidence)
    if not magnify > 0:
        raise ValueError(f"expected magnify > 0, got {magnify!r}")
    look = {"linewidth": 1.8, "markersize": 4, "zorder": 3, "label": label, **style.own_look(ax, line_kwargs)}
    (line,) = ax.plot(profile.xy[:, 0], profile.xy[:, 1], markevery=marks, **look)
    at = PointDrift(profile.distance[marks], profile.moments[np.asarray(marks)])
    centre = at.xy + magnify * at.bias
    scale = "" if magnify == 1 else f", drawn {magnify:g} × its size"
    legend = f"{100 * confidence:g} % error ellipse every {spacing:g} m{scale}"
    rgb, line_style = to_rgb(line.get_color()), line.get_linestyle()
    own: dict[str, Any] = {"facecolor": (*rgb, 0.12), "edgecolor": (*rgb, 0.9), "linestyle": line_style, "zorder": 2}
    ellipses: list[Patch] = []
    for x, y, width, height, angle in zip(*centre.T, *error_ellipse(at.cov, confidence), strict=True):
        own["label"] = "_nolegend_" if ellipses else legend
        ellipse = Ellipse((x, y), magnify * width, magnify * height, angle=angle, linewidth=0.9, **own)
        ellipses.append(ax.add_patch(ellipse))
    style.arrow_along(ax, profile.xy, line.get_color())
    start, goal = style.mark_ends(ax, [profile.xy])
    style.in_metres(ax)
    return RouteArtists(line, ellipses, start, goal)


class BeaconArtists(NamedTuple):
    """What `plot_beacons` drew: the others first, then those ``used``, on top."""

    ranges: list[Patch]
    marks: list[Line2D]


def plot_beacons(
    beacons: Sequence[Beacon],
    *,
    ax: Axes | None = None,
    used: Sequence[Beacon] = (),
    labels: tuple[str, str] = ("beacon counted on", "other beacon"),
) -> BeaconArtists:
    """Draw beacons with their ranges and, if they are few, their ids: filled ranges and triangles for those ``used``,
    dotted ranges and squares for the others. A beacon that is not seen from everywhere has a sector for a range.

    Parameters
    ----------
    beacons : all there are; those ``used`` may be among them
    labels : (str, str), in a legend: of the used ones, of the others
    """
    ax = style.current_axes(ax)
    counted = {id(beacon) for beacon in used}
    others = [beacon for beacon in beacons if id(beacon) not in counted]
    ranges: list[Patch] = []
    marks: list[Line2D] = []
    for group, label, range_look, mark_look in (
        (others, labels[1], style.OTHER_RANGE, style.OTHER_BEACON),
        (list(used), labels[0], style.RANGE, style.BEACON),
    ):
        for beacon in group:
            ranges.append(ax.add_patch(_range_of(beacon, zorder=1.5, linewidth=0.8, **range_look)))
            if len(others) + len(used) <= _MAX_IDS:
                style.name_at(ax, beacon.id, (beacon.x, beacon.y), (4, 4), fontsize=7, zorder=4.8)
        if group:
            dots: dict[str, Any] = {"linestyle": "none", "zorder": 4, "markeredgecolor": "white", **mark_look}
            marks += ax.plot(*np.transpose([beacon.xy for beacon in group]), label=label, **dots)
    return BeaconArtists(ranges, marks)


def _range_of(beacon: Beacon, **look: Any) -> Patch:
    from matplotlib.patches import Circle, Wedge

    if beacon.facing_deg is None or beacon.kind.view_angle_deg == 360:
        return Circle((beacon.x, beacon.y), beacon.kind.range_m, **look)
    half = beacon.kind.view_angle_deg / 2
    return Wedge(beacon.xy.tolist(), beacon.kind.range_m, beacon.facing_deg - half, beacon.facing_deg + half, **look)


def drift_of(route: Route | Drift) -> Drift:
    return route if isinstance(route, Drift) else route.drift


def mark_spacing_of(drifts: Sequence[Drift], spacing_m: float | None) -> float:
    longest = max(float(drift.length) for drift in drifts)
    return mark_spacing(longest) if spacing_m is None else positive("spacing_m", spacing_m)


def marked_profile(drift: Drift, spacing_m: float) -> tuple[PointDrift, list[int]]:
    """The drift in small steps, and which of them are the marks."""
    profile = drift.profile(spacing_m / _SAMPLES_PER_MARK)
    marks = mark_distances(float(drift.length), spacing_m)
    return profile, [int(np.searchsorted(profile.distance, s * (1 + 1e-9), side="right")) - 1 for s in marks]


def box_around(*lines: Floats) -> tuple[float, float, float, float]:
    """Bounds of polylines with a margin of a tenth, and never thinner than a fifth of their greater side."""
    xy = np.concatenate(lines)
    middle, half = (xy.max(axis=0) + xy.min(axis=0)) / 2, np.ptp(xy, axis=0) / 2
    side = 2 * float(half.max()) or 1.0
    half = np.maximum(half + 0.1 * side, 0.2 * side)
    (xmin, ymin), (xmax, ymax) = (middle - half).tolist(), (middle + half).tolist()
    return xmin, ymin, xmax, ymax


def diagonal(box: Sequence[float]) -> float:
    return hypot(box[2] - box[0], box[3] - box[1])


def error_ellipse(cov: ArrayLike, confidence: float = 0.95) -> tuple[Floats, Floats, Floats]:
    """Width, height and tilt of the ellipse that holds a Gaussian error of covariance ``cov`` with this confidence.

    Of ``cov`` (..., 2, 2) in m² and a confidence in (0, 1) it makes width and height (...) in metres, full axes, the
    longer one first, and the angle from +x to it, counter-clockwise, in degrees, as matplotlib has it.

    >>> [round(float(x), 3) for x in error_ellipse([[4.0, 0.0], [0.0, 1.0]])]
    [9.791, 4.895, 0.0]
    """
    if not 0 < confidence < 1:
        raise ValueError(f"expected a confidence in (0, 1), got {confidence!r}")
    values, axes = np.linalg.eigh(np.asarray(cov, dtype=float))
    full = 2 * np.sqrt(-2 * np.log1p(-confidence) * np.maximum(values, 0.0))  # |e|² / σ² is chi-squared, 2 degrees
    # an axis has no direction: tilts in (-90°, 90°]
    x, y = axes[..., 0, 1], axes[..., 1, 1]
    return full[..., 1], full[..., 0], np.degrees(np.arctan2(np.where(x < 0, -y, y), np.abs(x)))


def mark_spacing(length_m: float) -> float:
    """A round distance (1, 2 or 5 times a power of ten, metres) that divides ``length_m`` into about eight pieces.

    >>> mark_spacing(62.0)
    10.0
    """
    if not length_m > 0:
        return 1.0
    wanted = length_m / 8
    return min(_round_numbers_about(wanted), key=lambda step: abs(log(step / wanted)))


def mark_distances(length_m: float, spacing_m: float) -> Floats:
    """Distances along a path to mark, metres: every ``spacing_m``, and the end.

    >>> mark_distances(33.0, 10.0)
    array([10., 20., 33.])
    """
    every = spacing_m * np.arange(1, floor(length_m / spacing_m) + 1)
    return np.append(every[every < length_m - 0.4 * spacing_m], length_m)


def magnification(drifts: Sequence[Drift], extent_m: float, confidence: float = 0.95) -> float:
    """How much to enlarge (or shrink) error ellipses on a map of diagonal ``extent_m``: ..., 0.5, 1, 2, 5, 10, 20, ...

    1 where the greatest ellipse at a waypoint takes 4 to 40 % of the diagonal, else the least change to get there.
    """
    widths = np.concatenate([np.ravel(error_ellipse(drift.cov, confidence)[0]) for drift in drifts])
    share = float(widths.max()) / extent_m
    if share < 1e-9 or 0.04 <= share <= 0.4:  # without noise there is nothing to see
        return 1.0
    if share < 0.04:
        return next(factor for factor in _round_numbers_about(0.04 / share) if factor >= 0.04 / share)
    return max(factor for factor in _round_numbers_about(0.4 / share) if factor <= 0.4 / share)


def _round_numbers_about(value: float) -> list[float]:
    """1, 2, 5 and 10 times the power of ten below ``value``, increasing."""
    exponent = floor(log10(value))
    return [float(f"{digit}e{exponent}") for digit in (1, 2, 5, 10)]
