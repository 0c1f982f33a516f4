"""PlanRequest: what a route is asked for, with every argument checked once."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from decimal import ROUND_CEILING, Context
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, choice, finite, instance, listener, number, point_of, positive, whole
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import waypoints_of
from driftplan.errors import GoalError, NoPathError, PlannerError, StartError
from driftplan.model.noise import OdometryNoise, check_continuous
from driftplan.model.readings import NEEDS_FILTER, Estimator, Fix
from driftplan.world.world import World
from driftplan.world.zones import noises_on

Objective = Literal["drift", "length", "worst_drift"]
ROADMAP = "roadmap"
DEFAULT_DETOUR = 1.5  # times the length of the shortest route: with beacons, unless length is minimised
_SEEDS = 2**31  # what OMPL takes, and one less
_USUAL_LIMIT_S = 5.0  # unless told otherwise
_NO_LIMIT_S = 1e8  # three years


@dataclass(frozen=True)
class DriftLimit:
    """What the drift must not exceed, anywhere on any route, and with how little help.

    Parameters
    ----------
    max_drift : metres, one number or one per route; None: there is no limit, the least drift is sought
    redundancy : the limit holds with any ``redundancy - 1`` beacons dead; 1: all live. Where routes are planned, at
        most 2; what is minimised is then the worst of those cases.
    confidence : in [0.75, 1), the limit is on the radius that holds the estimate so surely; None: on the rms, as it
        must be where routes are planned
    min_capture : in [0, 1), only where routes are planned: a beacon that the drifting robot would come within range of
        less surely than this on one of its passes (`driftplan.detection_chances`) is not counted on. None: 0.9.

    >>> DriftLimit(0.5, redundancy=2)
    DriftLimit(max_drift=0.5, redundancy=2, confidence=None, min_capture=None)
    """

    max_drift: float | Sequence[float] | None = None
    redundancy: int = 1
    confidence: float | None = None
    min_capture: float | None = None

    def __post_init__(self) -> None:
        whole("redundancy", self.redundancy, least=1)
        if self.confidence is not None and not 0.75 <= self.confidence < 1:
            raise ValueError(f"expected confidence in [0.75, 1), or None for rms, got {self.confidence!r}")
        if self.min_capture is not None and not 0 <= self.min_capture < 1:
            raise ValueError(f"expected min_capture in [0, 1), got {self.min_capture!r}")
        if self.max_drift is not None and not (finite("max_drift", self.max_drift) > 0).all():
            raise ValueError(f"expected max_drift finite and > 0 m, got {self.max_drift!r}")

    @classmethod
    def of(cls, limit: float | Sequence[float] | DriftLimit | None) -> DriftLimit:
        """A limit that may be given as metres."""
        return limit if isinstance(limit, DriftLimit) else cls(limit)

    def per_route(self, routes: int) -> tuple[float, ...]:
        """Metres, for every route."""
        values = np.asarray(self.max_drift, dtype=float)
        if values.shape not in ((), (routes,)):
            raise ValueError(f"expected max_drift one number or one per route ({routes}), got shape {values.shape}")
        return tuple(np.broadcast_to(values, (routes,)).tolist())


@dataclass(frozen=True, eq=False)
class Planner:
    """How a route is looked for.

    Parameters
    ----------
    name : "roadmap", or without beacons and limits of OMPL "rrtstar", "informed_rrtstar", "sorrtstar", "bitstar"
    max_nodes : of the roadmap among beacons, about
    initial_paths : other paths (n, 2) from start to goal to be considered: the route is never worse than the best of
        them that keeps the limit. A path that collides is refused.

    >>> Planner("bitstar").name, Planner(max_nodes=200).name
    ('bitstar', 'roadmap')
    """

    name: str = ROADMAP
    max_nodes: int = 1000
    initial_paths: Sequence[ArrayLike] = ()

    def __post_init__(self) -> None:
        whole("max_nodes", self.max_nodes, least=10)
        if self.name != ROADMAP:
            from driftplan.planning.ompl.solve import check_planner

            check_planner(self.name, also=(ROADMAP,))

    @classmethod
    def of(cls, planner: str | Planner) -> Planner:
        """A planner that may be given by its name."""
        return planner if isinstance(planner, Planner) else cls(planner)


@dataclass(frozen=True, eq=False)
class Reliance:
    """How far a route may count on beacons, and from what it starts.

    Attributes as the parameters of `driftplan.plan_route` and the fields of `DriftLimit`; ``max_drift`` infinite: no
    limit. Without beacons nothing is read, whatever the estimator: the exact moments of ``reset`` are taken.
    """

    beacons: tuple[Beacon, ...] = ()
    max_drift: float = math.inf
    max_detour: float | None = None
    redundancy: int = 1
    min_capture: float = 0.9
    start_fix: Fix | None = None
    start_heading: float | None = None
    estimator: Estimator = "reset"

    @classmethod
    def of(
        cls,
        beacons: Sequence[Beacon],
        limit: float | DriftLimit | None,
        max_detour: float | None,
        start_fix: Fix | None,
        estimator: Estimator,
    ) -> Reliance:
        """As the parameters of `driftplan.plan_route` say."""
        asked = DriftLimit.of(limit)
        if asked.confidence is not None:
            raise ValueError(f"expected a limit on the rms drift, without a confidence, got {asked}")
        metres = math.inf if asked.max_drift is None else positive("max_drift", asked.max_drift)
        sure = cls.min_capture if asked.min_capture is None else asked.min_capture
        return cls(tuple(beacons), metres, max_detour, asked.redundancy, sure, start_fix, None, estimator)

    def __post_init__(self) -> None:
        choice("estimator", self.estimator, Estimator)
        if self.estimator == "reset" and (beacons := [b for b in self.beacons if b.kind.needs_filter]):
            raise ValueError(f"{NEEDS_FILTER}: expected estimator='filter' for beacons of kind {beacons[0].kind.name}")
        if not self.beacons:
            object.__setattr__(self, "estimator", "reset")
        if self.max_detour is not None and not (math.isfinite(self.max_detour) and self.max_detour >= 1):
            raise ValueError(f"expected max_detour >= 1, got {self.max_detour!r}")
        if self.redundancy not in (1, 2):
            wanted = "1 (all beacons live) or 2 (any one may be dead)"
            raise ValueError(f"expected redundancy {wanted}, got {self.redundancy!r}")
        if self.start_fix is not None and not (isinstance(self.start_fix, Fix) and self.start_fix.s_m == 0):
            raise ValueError(f"expected start_fix a Fix at s_m=0, got {self.start_fix!r}")

    @property
    def bounding(self) -> tuple[Beacon, ...]:
        """The beacons as bounds see them: a filter may know more than any reading says, but nowhere else than here."""
        if self.estimator == "reset":
            return self.beacons
        measures_place = [b.kind.needs_filter or b.kind.position_std_m is not None for b in self.beacons]
        perfect = [replace(b, kind=replace(b.kind, position_std_m=0.0)) for b in self.beacons]
        return tuple(x if here else b for here, x, b in zip(measures_place, perfect, self.beacons, strict=True))

    def detour(self, minimise: Objective) -> float:
        """Greatest length as a multiple of the shortest route's."""
        if self.max_detour is not None:
            return self.max_detour
        return DEFAULT_DETOUR if self.beacons and minimise != "length" else math.inf


@dataclass(frozen=True, eq=False)
class PlanRequest:
    """What `plan_route` is asked for, after every argument has been looked at."""

    world: World
    ends: Any  # start, perhaps with a heading, and goal as given; then (2, 2), metres
    noise: OdometryNoise
    reliance: Reliance
    minimise: Objective = "drift"
    planner: Planner = field(default_factory=Planner)
    time_limit: float | None = None  # seconds
    iterations: int | None = None
    seed: int = 0
    until: Callable[[], bool] | None = None  # asked often: whether it is enough
    initial_paths: tuple[Any, ...] = field(init=False)  # (n, 2): the planner's, free, to the last digit from ends
    share: float = 1.0  # of the time limit that may be spent
    began: float = field(default_factory=lambda: time.monotonic())  # when the clock of the call began to run

    def __post_init__(self) -> None:
        instance("noise", self.noise, OdometryNoise)
        choice("minimise", self.minimise, Objective)
        if self.iterations is not None:
            whole("iterations", self.iterations, least=1)
        if whole("seed", self.seed, least=0) >= _SEEDS:
            raise ValueError(f"expected seed a whole number >= 0 and < {_SEEDS}, got {self.seed!r}")
        if self.time_limit is not None:
            positive("time_limit", self.time_limit)
        listener("until", self.until, "without arguments")
        if self.minimise == "length" and not self.needs_labels and self.reliance.max_detour is not None:
            raise ValueError(f"expected no max_detour with minimise='length', got {self.reliance.max_detour!r}")
        if self.needs_labels:
            check_continuous(noises_on(self.world, self.noise))
            if self.planner.name != ROADMAP:
                what = "for routes with beacons or max_drift"
                raise PlannerError(f"expected planner={ROADMAP!r} {what}, got {self.planner.name!r}")
        start, goal = self.ends
        if finite("start", start, "(x, y) or (x, y, heading)").shape == (3,):
            *start, heading = (number("a number of start", value) for value in start)
            object.__setattr__(self, "reliance", replace(self.reliance, start_heading=heading))
        ends = checked_ends(self.world, start, goal)
        object.__setattr__(self, "ends", ends)
        paths = tuple(_checked_path(self.world, ends, path) for path in self.planner.initial_paths)
        object.__setattr__(self, "initial_paths", paths)

    @property
    def until_done(self) -> bool:
        """Whether to end when more time would bring next to nothing: nothing else is said that ends the search."""
        return self.time_limit is None and self.iterations is None and self.until is None

    @property
    def limit_s(self) -> float:
        """Seconds that may be spent; huge where something else ends the search and no limit is given."""
        usual = _USUAL_LIMIT_S if self.until_done else _NO_LIMIT_S
        return self.share * (usual if self.time_limit is None else self.time_limit)

    def left_s(self, share: float = 1.0) -> float:
        """Seconds left of a share of the time limit; negative when it is over, or ``until`` says that it is enough."""
        if self.until is not None and self.until():
            return -math.inf
        return share * self.limit_s - (time.monotonic() - self.began)

    @property
    def needs_labels(self) -> bool:
        """Whether what is asked depends on more than the end of the route: beacons, a limit, or the worst drift."""
        reliance = self.reliance
        return bool(reliance.beacons) or reliance.max_drift < math.inf or self.minimise == "worst_drift"


def check_connected(world: World, ends: Floats) -> None:
    """Refuse, with a NoPathError, ends (2, 2) in different parts of the free space."""
    start_part, goal_part = world.free_part(ends)
    if start_part != goal_part:
        part, (start, goal) = world.free_parts[start_part], map(format_point, ends)
        xmin, ymin, xmax, ymax = part.bounds
        raise NoPathError(
            f"no path from {start} to {goal}: a robot of radius {world.robot_radius:g} m that starts there reaches "
            f"only {part.area:.4g} m², x {xmin:.2f}..{xmax:.2f}, y {ymin:.2f}..{ymax:.2f} m"
        )


def checked_ends(world: World, start: ArrayLike, goal: ArrayLike, *, connected: bool = False) -> Floats:
    """Start and goal, (2, 2), which must be free, and joined by free space if that is asked."""
    points = []
    for name, value, error in (("start", start, StartError), ("goal", goal, GoalError)):
        point = np.array(point_of(name, value))
        if not world.is_free(point):
            wrong, nearest = blocked_end(world, name, point)
            raise error(f"{wrong}; the nearest free point is {format_point(nearest)}")
        points.append(point)
    if connected:
        check_connected(world, np.stack(points))
    return np.stack(points)


def blocked_end(world: World, name: str, point: Floats) -> tuple[str, Floats]:
    """What is wrong with a start or goal that is not free, in words, and the free point nearest to it: one that is
    still free when written to the millimetre, if there is any near."""
    xmin, ymin, xmax, ymax = world.bounds
    wrong = "is not free"
    if not (xmin <= point[0] <= xmax and ymin <= point[1] <= ymax):
        wrong = f"is off the map, which spans x {xmin:g} to {xmax:g} and y {ymin:g} to {ymax:g} m"
    nearest = world.nearest_free(point)
    way = nearest - point
    inward = way / max(float(np.linalg.norm(way)), 1e-12)
    for step in (0.0, 0.001, 0.002, 0.005, 0.02, 0.1):  # a little farther in, it is still free when written
        rounded = np.round(nearest + step * inward, 3)
        if world.is_free(rounded):
            nearest = rounded
            break
    return f"{name} {format_point(point)} {wrong}", nearest


def format_point(point: Floats) -> str:
    """A point in metres, to the millimetre."""
    x, y = (f"{round(float(c), 3) + 0.0:.3f}".rstrip("0").rstrip(".") for c in point)
    return f"({x}, {y})"


def format_least(metres: float) -> str:
    """The least drift that can be kept, in metres, rounded up to three digits: as a limit it can be kept too.

    >>> format_least(1.66491), format_least(math.inf)
    ('1.67 m', 'not known')
    """
    if not math.isfinite(metres):
        return "not known"
    return f"{Context(prec=3, rounding=ROUND_CEILING).create_decimal(repr(float(metres))):g} m"


def _checked_path(world: World, ends: Floats, path: ArrayLike) -> Floats:
    """A path of the caller's, after it has been looked at."""
    points = waypoints_of(path, "initial_paths: ")
    if not np.allclose(points[[0, -1]], ends):
        wanted, got = (f"from {format_point(a)} to {format_point(b)}" for a, b in (ends, points[[0, -1]]))
        raise ValueError(f"expected initial_paths {wanted}, got one {got}")
    points = np.concatenate([ends[:1], points[1:-1], ends[1:]])  # to the last digit
    free = world.segments_free(points[:-1], points[1:])
    if not free.all():
        a, b = map(format_point, points[np.argmin(free) :][:2])
        raise ValueError(f"expected initial_paths free of collisions, got one that collides between {a} and {b}")
    return points
