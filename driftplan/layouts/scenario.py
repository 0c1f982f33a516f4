"""What is asked of a layout: routes, the noise on them, and the limit that their drift has to keep; and sites, where
beacons may go, of which kinds, at what cost and in which combinations: points of grids and walls."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, Ints, bounded, choice, finite, not_negative, positive
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.passes import passes_of
from driftplan.beacons.readings import BeaconColumns, drift_with_beacons, readings_on, waypoints_of
from driftplan.model.drift import Drift
from driftplan.model.noise import OdometryNoise, check_continuous
from driftplan.model.point_drift import PointDrift
from driftplan.model.readings import Estimator, Fix, Readings
from driftplan.model.worst import worst_radius, worst_rms
from driftplan.planning.request import DriftLimit
from driftplan.world.shapes import polygon_of
from driftplan.world.world import World
from driftplan.world.zones import noises_on

_FACINGS_DEG = (0.0, 90.0, 180.0, 270.0)
_MAX_SITES = 1e6  # far more than can be chosen from
_PLACES = 9  # of metres: sums of spacings are printed as people write them, 9.6 and not 9.600000000000001


@dataclass(frozen=True, eq=False)
class Scenario:
    """Routes and how drift on them is scored; made by `Scenario.of`."""

    world: World | None
    routes: tuple[Floats, ...]  # (n, 2) each, metres
    noise: OdometryNoise
    start_fix: Fix | None = None  # uncertainty at the start of every route
    confidence: float | None = None  # of the `DriftLimit`
    redundancy: int = 1  # likewise
    estimator: Estimator = "reset"  # what the robot does with a reading

    @classmethod
    def of(
        cls,
        world: World | None,
        routes: Any,
        noise: OdometryNoise,
        limit: DriftLimit,
        start_fix: Fix | None = None,
        estimator: Estimator = "reset",
    ) -> Scenario:
        """A scenario of one route or several, each (n, 2) or an object with a ``path``; all of it checked."""
        choice("estimator", estimator, Estimator)
        if limit.min_capture is not None:
            raise ValueError(f"expected no min_capture where routes are given: every reading counts, got {limit}")
        if estimator == "filter" and limit.confidence is not None:
            got = f"got {limit.confidence:g}: with a filter limits are on the rms"
            raise ValueError(f"expected confidence only for estimator='reset', {got}")
        if start_fix is not None and not (isinstance(start_fix, Fix) and start_fix.s_m == 0):
            raise ValueError(f"expected start_fix to be a Fix at s_m=0, got {start_fix!r}")
        check_continuous(noises_on(world, noise))
        return cls(world, _routes_of(routes), noise, start_fix, limit.confidence, limit.redundancy, estimator)

    @property
    def drives_differ(self) -> bool:
        """Whether systematic errors differ from one drive to the next, on any floor."""
        return any(noise.varies_between_drives for noise in noises_on(self.world, self.noise))

    def drift(self, route: int, beacons: Sequence[Beacon]) -> Drift:
        """Drift along one route with the given beacons alive."""
        fixes = () if self.start_fix is None else (self.start_fix,)
        path, estimator = self.routes[route], self.estimator
        return drift_with_beacons(path, self.noise, beacons, self.world, fixes=fixes, estimator=estimator)

    def readings(self, beacons: Sequence[Beacon]) -> tuple[Readings, ...]:
        """What could be read of beacons on every route."""
        columns = BeaconColumns.of(beacons)
        return tuple(readings_on(path, columns, self.world) for path in self.routes)

    def score(self, drift: PointDrift) -> Floats:
        """The score that limits are about: rms, or the radius at the confidence."""
        return drift.rms if self.confidence is None else drift.radius(self.confidence)

    def worst(self, drift: Drift) -> float:
        """Greatest score anywhere along a route, metres: `worst_rms`, or `worst_radius` at the confidence."""
        return worst_rms(drift) if self.confidence is None else worst_radius(drift, self.confidence)

    def beacons_in_range(self, route: int, beacons: Sequence[Beacon]) -> list[int]:
        """Positions of the beacons that a route comes within range of, and in sight where they must be seen."""
        return beacons_in_range(self.world, self.routes[route], beacons)


def beacons_in_range(world: World | None, path: Floats, beacons: Sequence[Beacon]) -> list[int]:
    """Positions of the beacons that a path comes within range of, and in sight where they must be seen."""
    return list(map(int, np.unique(BeaconColumns.of(beacons).passes(path, world).beacon)))


def _routes_of(routes: Any) -> tuple[Floats, ...]:
    try:
        array = np.asarray(routes)
    except (TypeError, ValueError):
        array = np.zeros(0)  # several of different lengths
    if hasattr(routes, "path") or (array.ndim == 2 and array.dtype.kind in "iuf"):
        return (waypoints_of(routes),)
    if array.ndim == 0 or isinstance(routes, (str, bytes)) or not hasattr(routes, "__len__") or not len(routes):
        raise ValueError(f"expected routes to be one path (n, 2) or a sequence of them, got {routes!r}")
    return tuple(waypoints_of(route, f"route {k}: ") for k, route in enumerate(routes))


@dataclass(frozen=True, slots=True)
class SiteGroup:
    """Sites, by their position in the list or by id, of which at least and at most so many may be chosen.

    >>> SiteGroup(members=["S1", "S2", "S7"], at_most=1).at_least  # one socket for three places
    0
    """

    members: Sequence[int | str]
    at_least: int = 0
    at_most: int | None = None


@dataclass(frozen=True, eq=False)
class Sites:
    """Where beacons may go.

    Parameters
    ----------
    kind : what may be placed at ``points``; each kind at each point is one site, or four, looking four ways, if it is
        not seen from everywhere (with ``costs`` or other facings: give Beacons as ``points``)
    points : (n, 2) in metres, or Beacons; None: a grid over the world's free space (without a world: points along the
        routes), ``spacing_m`` apart (default: the smallest range), as far as a route comes into range
    spacing_m : of generated points
    costs : per point, (n,) or (n, kinds), > 0; default: the kind's cost
    existing : already there, for nothing; they may die like any other
    forbidden : polygons (shapely, or corners) with no sites inside
    groups : at least, or at most, so many of these sites
    min_spacing_m : new beacons are at least this far from each other and from existing ones

    >>> tag = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> [site.id for site in Sites(tag, [(2, 0), (5, 0)]).listed(None).new]
    ['S1', 'S2']
    """

    kind: BeaconKind | Sequence[BeaconKind] = ()
    points: ArrayLike | Sequence[Beacon] | None = None
    spacing_m: float | None = None
    costs: ArrayLike | None = None
    existing: Sequence[Beacon] = ()
    forbidden: Sequence[Any] = ()
    groups: Sequence[SiteGroup] = ()
    min_spacing_m: float = 0.0

    def __post_init__(self) -> None:
        points: Any = self.points
        if points is not None and self.spacing_m is not None:
            raise ValueError("expected spacing_m only for generated points, got both points and spacing_m")
        if points is None and self.costs is not None:
            raise ValueError("expected costs only together with points: use BeaconKind(cost=...) for generated ones")
        kinds = (self.kind,) if isinstance(self.kind, BeaconKind) else tuple(self.kind)
        if isinstance(points, Sequence) and points and all(isinstance(point, Beacon) for point in points):
            if kinds:
                raise ValueError("expected kind or points that are Beacons with a kind of their own, got both")
            points = tuple(points)
        elif not kinds:
            raise ValueError("expected kind: what beacons may be placed (BeaconKind.rfid, .landmark, .heading)")
        elif points is not None:
            points = finite("points", points)
            if points.ndim != 2 or points.shape[1] != 2:
                raise ValueError(f"expected points (n, 2) in metres, or Beacons, got shape {points.shape}")
        not_negative("min_spacing_m", self.min_spacing_m)
        if self.costs is not None:
            shape = (len(points), len(kinds)) if len(kinds) > 1 else (len(points),)
            costs = np.asarray(self.costs, dtype=float)
            if costs.shape != shape or not (np.isfinite(costs).all() and (costs > 0).all()):
                raise ValueError(f"expected costs of shape {shape}, finite and > 0, got {self.costs!r}")
            object.__setattr__(self, "costs", costs.ravel())
        for name, value in (("kind", kinds), ("points", points), ("existing", tuple(self.existing))):
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, sites: Any) -> Sites:
        """Sites that may be given as the kind, or kinds, of beacon."""
        return sites if isinstance(sites, Sites) else cls(sites)

    def listed(self, world: World | None, routes: Sequence[Floats] = ()) -> ListedSites:
        """All sites, one by one; generated ones as far as a route comes into range of them, if there are routes."""
        existing = _named(self.existing, "E", set())
        beacons = self._beacons(world, routes)
        if not beacons:
            why = ": none of the grid is free, allowed and in range of a route; a smaller spacing_m makes a finer one"
            raise ValueError("expected at least one site, got none" + why * (self.points is None and world is not None))
        beacons = _named(beacons, "S", {b.id for b in existing})
        costs = np.array([b.kind.cost for b in beacons]) if self.costs is None else np.asarray(self.costs, dtype=float)
        numbered = np.array([[b.x, b.y, k] for k, b in enumerate(beacons)])
        kept = allowed(numbered, self.forbidden)[:, 2].astype(np.intp)
        new = [beacons[k] for k in kept.tolist()]
        for name, count in Counter(b.id for b in (*new, *existing)).items():
            if count > 1:
                raise ValueError(f"expected every beacon to have its own id, got {name!r} twice")
        members = tuple(_members(f"group {g}", group, beacons, kept) for g, group in enumerate(self.groups))
        return ListedSites(tuple(new), costs[kept], tuple(existing), members)

    def _beacons(self, world: World | None, routes: Sequence[Floats]) -> list[Beacon]:
        points: Any = self.points
        kinds: Any = self.kind
        if isinstance(points, tuple):
            return list(points)
        if points is None:
            points = self._generated(world, routes, [kind.range_m for kind in kinds])
        return [
            Beacon(kind, x, y, facing_deg=facing)
            for x, y in points.tolist()
            for kind in kinds
            for facing in (_FACINGS_DEG if kind.view_angle_deg < 360 and self.costs is None else (None,))
        ]

    def _generated(self, world: World | None, routes: Sequence[Floats], ranges_m: Sequence[float]) -> Floats:
        """A grid over free space, or points along the routes without a world."""
        spacing_m = min(ranges_m) if self.spacing_m is None else self.spacing_m
        if world is None:
            return route_sites(routes, spacing_m, forbidden=self.forbidden)
        points = grid_sites(world, spacing_m, forbidden=self.forbidden)
        if not len(routes):
            return points
        in_range, range_m = np.zeros(len(points), dtype=bool), np.full(len(points), max(ranges_m))
        for route in routes:
            in_range[passes_of(route, points, range_m, np.zeros(len(points), dtype=bool), None).beacon] = True
        return points[in_range]


@dataclass(frozen=True, eq=False)
class ListedSites:
    """Sites one by one, each with an id of its own."""

    new: tuple[Beacon, ...]  # what may be placed, off forbidden areas
    costs: Floats  # (new,)
    existing: tuple[Beacon, ...]
    members: tuple[Ints, ...]  # for every group, its members by their position in ``new``


def _members(name: str, group: SiteGroup, beacons: Sequence[Beacon], kept: Ints) -> Ints:
    """The members of a group that are off forbidden areas, by their position among all of those."""
    position = {b.id: k for k, b in enumerate(beacons)}
    chosen = [position.get(member, -1) if isinstance(member, str) else int(member) for member in group.members]
    for member, k in zip(group.members, chosen, strict=True):
        if not 0 <= k < len(beacons):
            raise ValueError(f"{name}: expected members to be sites, got {member!r}")
    return np.flatnonzero(np.isin(kept, chosen))


def _named(beacons: Sequence[Beacon], letter: str, taken: set[str]) -> list[Beacon]:
    """The same beacons, those without an id named by letter and position (and a + where that is taken)."""
    named = []
    for k, beacon in enumerate(beacons, start=1):
        name = beacon.id or f"{letter}{k}"
        while not beacon.id and name in taken:
            name += "+"
        named.append(replace(beacon, id=name))
    return named


def grid_sites(world: World, spacing_m: float, *, forbidden: Sequence[Any] = ()) -> Floats:
    """Points of a square grid, ``spacing_m`` apart, where the robot's centre may be: (n, 2), row by row from below.

    >>> world = World.from_polygons([[(2, 0), (3, 0), (3, 4), (2, 4)]], bounds=(0, 0, 5, 4), robot_radius=0.4)
    >>> grid_sites(world, 1.0).shape
    (16, 2)
    """
    spacing = positive("spacing_m", spacing_m)
    xmin, ymin, xmax, ymax = world.bounds
    bounded("sites of a grid", (xmax - xmin) * (ymax - ymin) / spacing**2, _MAX_SITES, "use a larger spacing_m")
    sides = (xmin, xmax), (ymin, ymax)
    x, y = (low + spacing / 2 + spacing * np.arange(int((high - low) / spacing)) for low, high in sides)
    xy = np.round(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2), _PLACES)
    return allowed(xy[world.is_free(xy)], forbidden)


def wall_sites(world: World, spacing_m: float, *, forbidden: Sequence[Any] = ()) -> Floats:
    """Points on the outlines of the obstacles, at most ``spacing_m`` apart: (n, 2), outline by outline.

    >>> world = World.from_polygons([[(2, 0), (3, 0), (3, 4), (2, 4)]], bounds=(0, 0, 5, 4), robot_radius=0.4)
    >>> wall_sites(world, 1.0).shape
    (10, 2)
    """
    rings = shapely.get_rings(shapely.get_parts(world.obstacles))
    outlines = [_along(ring, positive("spacing_m", spacing_m))[:-1] for ring in rings]
    return allowed(np.concatenate([np.zeros((0, 2)), *outlines]), forbidden)


def route_sites(routes: Sequence[Any], spacing_m: float, *, forbidden: Sequence[Any] = ()) -> Floats:
    """Points on the routes, at most ``spacing_m`` apart, ends included: (n, 2), route by route, none twice.

    >>> route_sites([[(0, 0), (4, 0)]], 2.0).tolist()
    [[0.0, 0.0], [2.0, 0.0], [4.0, 0.0]]
    """
    spacing = positive("spacing_m", spacing_m)
    if len(routes) == 0:
        raise ValueError("expected routes, got none")
    xy = np.concatenate([_along(shapely.LineString(waypoints_of(route)), spacing) for route in routes])
    _, first = np.unique(np.round(xy, 6), axis=0, return_index=True)
    return allowed(xy[np.sort(first)], forbidden)


def allowed(xy: Floats, forbidden: Sequence[Any]) -> Floats:
    """The points outside all ``forbidden`` areas: shapely polygons, or (n, 2) arrays of corners."""
    for area in forbidden:
        polygon = polygon_of("a forbidden area", area)
        xy = xy[~shapely.intersects_xy(polygon, xy[:, 0], xy[:, 1])]
    return xy


def _along(line: Any, spacing: float) -> Floats:
    """Evenly spaced points of a line, both ends included."""
    bounded("sites along a line", line.length / spacing, _MAX_SITES, "use a larger spacing_m")
    parts = max(1, int(np.ceil(line.length / spacing - 1e-9)))
    places = np.linspace(0.0, line.length, parts + 1)
    return np.asarray(np.round(shapely.get_coordinates(shapely.line_interpolate_point(line, places)), _PLACES))
