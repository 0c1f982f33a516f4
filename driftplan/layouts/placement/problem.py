"""A placement problem as the covering core wants it: sites, costs, demands and caps, checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from driftplan.arrays import Bools, Floats, Ints, finite, not_negative, whole
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.passes import passes_of
from driftplan.beacons.readings import waypoints_of
from driftplan.layouts.layout import Task
from driftplan.layouts.placement.candidates import allowed, grid_sites, route_sites
from driftplan.layouts.placement.cut_pool import Cut
from driftplan.layouts.placement.hops import Limit
from driftplan.layouts.placement.requirements import DriftRequirements
from driftplan.layouts.placement.tracks import Tracks, lay_tracks
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.world.world import World


@dataclass(frozen=True, slots=True)
class SiteGroup:
    """Candidates of which at least and at most so many may be chosen.

    Parameters
    ----------
    members : sequence of int or str
        Positions in the list of candidates, or ids.
    at_least : int
    at_most : int or None

    Examples
    --------
    >>> SiteGroup(["A1", "A2", "A3"], at_most=1).at_least
    0
    """

    members: Sequence[int | str]
    at_least: int = 0
    at_most: int | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacementProblem:
    """Sites (candidates, then existing beacons), what they cost, and which combinations are allowed.

    Attributes
    ----------
    task : Task
    sites : tuple of Beacon
    cost : (sites,), 0 for existing ones
    fixed : (sites,) which exist
    demands, caps : tuples of Cut, as `covering.cheapest_cover` takes them
    rules : what the caps are, for messages
    """

    task: Task
    sites: tuple[Beacon, ...]
    cost: Floats
    fixed: Bools
    demands: tuple[Cut, ...]
    caps: tuple[Cut, ...]
    rules: tuple[str, ...]

    def tracks(self, least_limit_m: float) -> Tracks:
        """The routes and the readings of all sites on them."""
        task = self.task
        return lay_tracks(
            task.routes, task.noise, self.sites, task.world, start_fix=task.start_fix, least_limit_m=least_limit_m
        )

    def requirements(self, tracks: Tracks, limits_m: Sequence[float]) -> DriftRequirements:
        """What the limits, one per route, demand."""
        limit = Limit(np.array(limits_m, dtype=float), self.task.confidence)
        return DriftRequirements(tracks, len(self.sites), limit, self.task.redundancy)

    def chosen(self, which: Bools) -> tuple[Beacon, ...]:
        """The candidates chosen."""
        return tuple(self.sites[i] for i in np.flatnonzero(which & ~self.fixed))

    @property
    def existing(self) -> tuple[Beacon, ...]:
        return tuple(self.sites[i] for i in np.flatnonzero(self.fixed))


def placement_problem(
    world: World | None,
    routes: Any,
    noise: OdometryNoise,
    *,
    kind: BeaconKind | Sequence[BeaconKind] | None = None,
    candidates: Any = None,
    spacing_m: float | None = None,
    costs: Any = None,
    existing: Sequence[Beacon] = (),
    redundancy: int = 1,
    confidence: float | None = None,
    forbidden: Sequence[Any] = (),
    min_spacing_m: float = 0.0,
    groups: Sequence[SiteGroup] = (),
    max_beacons: int | None = None,
    budget: float | None = None,
    start_fix: Fix | None = None,
) -> PlacementProblem:
    """The problem that the arguments of `driftplan.layouts.placement.place.place_beacons` describe."""
    task = Task(
        world=world,
        routes=routes_of(routes),
        noise=_continuous("noise", noise),
        start_fix=_start(start_fix),
        confidence=_confidence(confidence),
        redundancy=whole("redundancy", redundancy, least=1),
    )
    for k, zone in enumerate(world.zones if world is not None else ()):
        _continuous(f"the noise of zone {k}", zone.noise)
    for beacon in existing:
        if not isinstance(beacon, Beacon):
            raise ValueError(f"expected existing to be Beacon objects, got {beacon!r}")
    old = _named(existing, "E", set())
    listed, cost = _candidates(task, _kinds(kind), candidates, spacing_m, costs, forbidden)
    listed = _named(listed, "S", {b.id for b in old})
    kept = _outside(listed, forbidden)
    sites = (*(listed[i] for i in kept.tolist()), *old)
    _unique_ids(sites)
    new = np.arange(len(kept))
    demands, caps, rules = _groups(groups, listed, kept)
    if max_beacons is not None:
        caps.append(Cut(new, -np.ones(len(new)), -float(whole("max_beacons", max_beacons, least=0))))
        rules.append(f"max_beacons={max_beacons}")
    if budget is not None:
        caps.append(Cut(new, -cost[kept], -not_negative("budget", budget)))
        rules.append(f"budget={budget:g}")
    if not_negative("min_spacing_m", min_spacing_m) > 0:
        caps += _too_close(sites, len(kept), min_spacing_m)
        rules.append(f"min_spacing_m={min_spacing_m:g}")
    return PlacementProblem(
        task=task,
        sites=sites,
        cost=np.concatenate([cost[kept], np.zeros(len(old))]),
        fixed=np.arange(len(sites)) >= len(kept),
        demands=tuple(demands),
        caps=tuple(caps),
        rules=tuple(rules),
    )


def routes_of(routes: Any) -> tuple[Floats, ...]:
    """One route or several, each (n, 2) or an object with a ``path``, as a tuple of arrays."""
    if hasattr(routes, "path"):
        return (waypoints_of(routes),)
    try:
        array = np.asarray(routes, dtype=float)
    except (TypeError, ValueError):
        array = np.zeros(0)  # several of different lengths
    if array.ndim == 2:
        return (waypoints_of(array),)
    if isinstance(routes, (str, bytes)) or not hasattr(routes, "__len__") or not len(routes):
        raise ValueError(f"expected routes to be one path (n, 2) or a sequence of them, got {routes!r}")
    found = []
    for k, route in enumerate(routes):
        try:
            found.append(waypoints_of(route))
        except ValueError as err:
            raise ValueError(f"route {k}: {err}") from None
    return tuple(found)


def limits_of(max_drift: Any, routes: int) -> tuple[float, ...]:
    """The limit of every route, metres."""
    values = np.asarray(max_drift, dtype=float)
    if values.ndim > 1 or values.shape not in ((), (routes,)):
        raise ValueError(f"expected max_drift to be one number or one per route ({routes}), got shape {values.shape}")
    values = np.broadcast_to(values, (routes,))
    if not (np.isfinite(values).all() and (values > 0).all()):
        raise ValueError(f"expected max_drift finite and > 0 m, got {max_drift!r}")
    return tuple(values.tolist())


def _continuous(name: str, noise: Any) -> OdometryNoise:
    if not isinstance(noise, OdometryNoise):
        raise ValueError(f"expected {name} to be an OdometryNoise, got {noise!r}")
    if noise.step_m is not None:
        rates = {
            name: getattr(noise, f"{name}_per_m") + getattr(noise, f"{name}_per_step") / noise.step_m
            for name in ("heading_var", "distance_var", "lateral_var")
        }
        said = ", ".join(f"{name}_per_m={rate:g}" for name, rate in rates.items() if rate)
        raise ValueError(
            f"expected {name} without step_m: in the step model the drift depends on where a path is cut, so a limit "
            f"'everywhere' has no exact meaning; use rates per metre, here OdometryNoise({said})"
        )
    return noise


def _start(start_fix: Any) -> Fix | None:
    if start_fix is None or (isinstance(start_fix, Fix) and start_fix.s_m == 0):
        return start_fix
    raise ValueError(f"expected start_fix to be a Fix at s_m=0, got {start_fix!r}")


def _confidence(confidence: float | None) -> float | None:
    if confidence is None or 0.75 <= confidence < 1:
        return confidence
    raise ValueError(f"expected confidence in [0.75, 1), or None for rms, got {confidence!r}")


def _kinds(kind: Any) -> list[BeaconKind]:
    kinds = [] if kind is None else [kind] if isinstance(kind, BeaconKind) else list(kind)
    for one in kinds:
        if not isinstance(one, BeaconKind):
            raise ValueError(f"expected kind to be a BeaconKind or several, got {one!r}")
    return kinds


def _candidates(
    task: Task,
    kinds: list[BeaconKind],
    candidates: Any,
    spacing_m: float | None,
    costs: Any,
    forbidden: Sequence[Any],
) -> tuple[list[Beacon], Floats]:
    """Candidates as listed by the caller, or generated, and their costs."""
    if candidates is not None and len(candidates) and all(isinstance(c, Beacon) for c in candidates):
        if kinds:
            raise ValueError("expected kind or candidates that are Beacon objects with a kind of their own, got both")
        listed = list(candidates)
        shape: tuple[int, ...] = (len(listed),)
    else:
        if not kinds:
            raise ValueError("expected kind: what beacons may be placed (BeaconKind.rfid, .landmark, .heading)")
        if candidates is None:
            points = _generated(task, kinds, spacing_m, forbidden)
        else:
            points = finite("candidates", candidates)
            if points.ndim != 2 or points.shape[1] != 2:
                raise ValueError(f"expected candidates (n, 2) in metres, or Beacons, got shape {points.shape}")
        listed = [Beacon(kind, x, y) for x, y in points.tolist() for kind in kinds]
        shape = (len(points),) if len(kinds) == 1 else (len(points), len(kinds))
    if not listed:
        raise ValueError("expected at least one candidate, got none")
    if candidates is not None and spacing_m is not None:
        raise ValueError("expected spacing_m only for generated candidates, got both candidates and spacing_m")
    if costs is None:
        return listed, np.array([b.kind.cost for b in listed])
    if candidates is None:
        raise ValueError("expected costs only together with candidates: use BeaconKind(cost=...) for generated ones")
    cost = np.asarray(costs, dtype=float)
    if cost.shape != shape or not (np.isfinite(cost).all() and (cost > 0).all()):
        raise ValueError(f"expected costs of shape {shape}, finite and > 0, got {costs!r}")
    return listed, cost.ravel()


def _generated(task: Task, kinds: list[BeaconKind], spacing_m: float | None, forbidden: Sequence[Any]) -> Floats:
    """A grid over free space (along the routes without a world), as far as a route comes into range."""
    reach = max(kind.range_m for kind in kinds)
    spacing = min(kind.range_m for kind in kinds) if spacing_m is None else spacing_m
    if task.world is None:
        return route_sites(task.routes, spacing, forbidden=forbidden)
    points = grid_sites(task.world, spacing, forbidden=forbidden)
    useful = np.zeros(len(points), dtype=bool)
    nothing_hides = np.zeros(len(points), dtype=bool)
    for route in task.routes:
        useful[passes_of(route, points, np.full(len(points), reach), nothing_hides, None).beacon] = True
    return points[useful]


def _outside(listed: list[Beacon], forbidden: Sequence[Any]) -> Ints:
    """Positions of the candidates outside all forbidden areas."""
    xy = np.array([[b.x, b.y] for b in listed])
    marked = np.concatenate([xy, np.arange(len(xy))[:, None]], axis=1)
    return np.asarray(allowed(marked, forbidden)[:, 2], dtype=np.intp)


def _groups(groups: Sequence[SiteGroup], listed: list[Beacon], kept: Ints) -> tuple[list[Cut], list[Cut], list[str]]:
    """Demands and caps of groups, and what they are."""
    position = {b.id: k for k, b in enumerate(listed)}
    column = {k: c for c, k in enumerate(kept.tolist())}
    demands, caps, rules = [], [], []
    for number, group in enumerate(groups):
        members = []
        for member in group.members:
            k = position.get(member, -1) if isinstance(member, str) else int(member)
            if not 0 <= k < len(listed):
                raise ValueError(f"group {number}: expected members to be candidates, got {member!r}")
            members.append(k)
        columns = np.array(sorted({column[k] for k in members if k in column}), dtype=np.intp)
        least = whole(f"group {number}: at_least", group.at_least, least=0)
        if least > 0:
            demands.append(Cut(columns, np.ones(len(columns)), float(least), (-2, number)))
        if group.at_most is not None:
            most = whole(f"group {number}: at_most", group.at_most, least=least)
            caps.append(Cut(columns, -np.ones(len(columns)), -float(most)))
            rules.append(f"group {number}: at_most={most}")
    return demands, caps, rules


def _too_close(sites: Sequence[Beacon], new: int, spacing_m: float) -> list[Cut]:
    """Caps that keep new sites apart from each other and from existing ones, as few as greedy cliques make them."""
    from scipy.spatial import cKDTree

    xy = np.array([[b.x, b.y] for b in sites])
    pairs = cKDTree(xy).query_pairs(spacing_m * (1 - 1e-9), output_type="ndarray")
    neighbours: dict[int, set[int]] = {}
    caps = []
    for i, j in pairs.tolist():
        if i < new <= j:
            caps.append(Cut(np.array([i]), -np.ones(1), 0.0))
        elif j < new:
            neighbours.setdefault(i, set()).add(j)
            neighbours.setdefault(j, set()).add(i)
    open_pairs = {i: {j for j in near if j > i} for i, near in neighbours.items()}
    for i in sorted(open_pairs):
        while open_pairs[i]:
            clique = [i, min(open_pairs[i])]
            for j in sorted(open_pairs[i]):
                if j not in clique and all(j in neighbours[c] for c in clique):
                    clique.append(j)
            for a in clique:
                open_pairs[a] -= set(clique)
            columns = np.array(sorted(clique), dtype=np.intp)
            caps.append(Cut(columns, -np.ones(len(columns)), -1.0))
    return caps


def _named(beacons: Sequence[Beacon], letter: str, taken: set[str]) -> list[Beacon]:
    """The same beacons, those without an id named by letter and position (and a + where that is taken)."""
    named = []
    for k, beacon in enumerate(beacons, start=1):
        name = beacon.id or f"{letter}{k}"
        while not beacon.id and name in taken:
            name += "+"
        named.append(replace(beacon, id=name))
    return named


def _unique_ids(sites: Sequence[Beacon]) -> None:
    seen: set[str] = set()
    for beacon in sites:
        if beacon.id in seen:
            raise ValueError(f"expected every beacon to have its own id, got {beacon.id!r} twice")
        seen.add(beacon.id)
