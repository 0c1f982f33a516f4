"""place_beacons: the fewest, or cheapest, beacons that keep the drift of every route under a limit, proven."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftplan.arrays import whole
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.errors import InfeasibleError
from driftplan.layouts.layout import Layout
from driftplan.layouts.placement.covering import Cover, Outcome, cheapest_cover
from driftplan.layouts.placement.cut_pool import Cut
from driftplan.layouts.placement.drives import drives_of, worst_squares
from driftplan.layouts.placement.problem import PlacementProblem, SiteGroup, limits_of, placement_problem
from driftplan.layouts.placement.reasons import explain
from driftplan.layouts.placement.spans import Spans
from driftplan.layouts.placement.tracks import Tracks
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.world.world import World

Progress = Callable[[float, float, float], None]

_ROUNDING = 1e-6  # relative: the final check adds the same numbers in another order
_RADIUS_ROUNDING = 1e-5  # and integrates radii to that
_CHECK_S = 0.03  # seconds kept for the final check, per route, but at most a quarter of the time
_FINEST = 0.02  # without a limit, and with perfect beacons: pieces are cut for this share of the drift without beacons


def place_beacons(
    world: World | None,
    routes: Any,
    noise: OdometryNoise,
    *,
    max_drift: float | Sequence[float] | None = None,
    kind: BeaconKind | Sequence[BeaconKind] | None = None,
    candidates: ArrayLike | Sequence[Beacon] | None = None,
    spacing_m: float | None = None,
    costs: ArrayLike | None = None,
    existing: Sequence[Beacon] = (),
    redundancy: int = 1,
    confidence: float | None = None,
    forbidden: Sequence[Any] = (),
    min_spacing_m: float = 0.0,
    groups: Sequence[SiteGroup] = (),
    max_beacons: int | None = None,
    budget: float | None = None,
    start_fix: Fix | None = None,
    drift_tolerance: float = 0.005,
    time_limit: float = 60.0,
    progress: Progress | None = None,
) -> Layout:
    """The cheapest layout that keeps the drift under a limit everywhere on every route, with a proof; or, without a
    limit, the layout within a budget whose worst drift is least.

    The drift is that of `driftplan.beacons.beacon.drift_with_beacons`: readings replace the error they measure, exact
    second moments, no fusion. Because a coarse or late reading may be worse than none, adding a beacon to a layout that
    holds can break it; "holds" is decided for the whole layout, and so is the proof. "Everywhere" is meant: on arrival
    and after every reading and every turn on the spot, and between the computed points, where the rms is bounded to a
    ten-billionth (see `driftplan.model.worst`). With a ``confidence``, the radius is looked at closely wherever it
    comes near the limit instead; it has no such bound.

    Parameters
    ----------
    world : World or None
        Its walls block sight, its zones have their own noise, and candidates are generated in its free space.
    routes : one route or many, each waypoints (n, 2) in metres or an object with such a ``path``
    noise : OdometryNoise
        Of the continuous kind (no ``step_m``).
    max_drift : float or one per route, metres
        None: the least worst drift within ``max_beacons`` and ``budget`` is sought.
    kind : BeaconKind or several
        What may be placed at candidates that are points; each kind at each point is one candidate.
    candidates : (n, 2) points, or Beacons
        None: a grid over the world's free space (without a world: points along the routes), ``spacing_m`` apart
        (default: the smallest range), as far as a route comes into range.
    costs : (n,), or (n, kinds)
        Per candidate, > 0. Default: the kind's cost.
    existing : sequence of Beacon
        Already there, for nothing; they may die like any other.
    redundancy : int
        The limit holds with any ``redundancy - 1`` beacons dead; 1: all live.
    confidence : float in [0.75, 1)
        The limit is on the radius that holds the estimate with this confidence; None: on the rms.
    forbidden : sequence of polygons (shapely, or corners)
        No candidates inside.
    min_spacing_m : float
        New beacons are at least this far from each other and from existing ones.
    groups : sequence of SiteGroup
        At least, or at most, so many of these candidates.
    max_beacons : int
        At most so many new beacons.
    budget : float
        New beacons cost at most this.
    start_fix : Fix at 0
        Uncertainty at the start of every route; default: the start is known.
    drift_tolerance : float
        Without a limit: the worst drift is within this share of the least.
    time_limit : float
        Seconds. The best layout so far is returned when they are over, and ``status`` says so. The tables of the search
        are made and the layout is verified whatever the limit: a second for 60 routes and 1250 candidates, a dozen for
        500 and 5000.
    progress : callable
        Called with seconds, cost of the best layout and lower bound when one changes.

    Returns
    -------
    Layout
        Verified by `drift_with_beacons`, dead beacons included. Of layouts equally cheap it is one in which no beacon
        can be exchanged for a candidate listed earlier; the same input gives the same layout, unless the search or a
        part of it ran out of time.

    Raises
    ------
    InfeasibleError
        If no layout will do: the message names route and stretch, the least drift reachable there and the candidates
        that come closest. Also if none was found in time.
    ValueError
        For input that makes no sense.

    Examples
    --------
    >>> noise = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
    >>> tag = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01)
    >>> layout = place_beacons(None, [(0, 0), (60, 0), (60, 30)], noise, max_drift=0.6, kind=tag, spacing_m=2.0)
    >>> len(layout.beacons), layout.proven, layout.worst_drift < 0.6
    (3, True, True)
    """
    began = time.monotonic()
    if not (isinstance(time_limit, (int, float)) and time_limit > 0):
        raise ValueError(f"expected time_limit > 0 s, got {time_limit!r}")
    problem = placement_problem(
        world,
        routes,
        noise,
        kind=kind,
        candidates=candidates,
        spacing_m=spacing_m,
        costs=costs,
        existing=existing,
        redundancy=redundancy,
        confidence=confidence,
        forbidden=forbidden,
        min_spacing_m=min_spacing_m,
        groups=groups,
        max_beacons=max_beacons,
        budget=budget,
        start_fix=start_fix,
    )
    search = _Search(problem, began, time_limit, progress)
    if max_drift is None:
        if max_beacons is None and budget is None:
            raise ValueError("expected max_drift, or max_beacons or budget for the least drift within them, got none")
        return search.least_drift(drift_tolerance)
    return search.cheapest(limits_of(max_drift, len(problem.task.routes)))


def beacon_tradeoff(
    world: World | None,
    routes: Any,
    noise: OdometryNoise,
    *,
    up_to: int = 20,
    drift_tolerance: float = 0.005,
    time_limit: float = 300.0,
    **options: Any,
) -> tuple[Layout, ...]:
    """The trade-off curve: for 0, 1, 2, … beacons the layout with the least worst drift.

    Parameters
    ----------
    world, routes, noise, drift_tolerance :
        As for `place_beacons`.
    up_to : int
        The greatest number of beacons.
    time_limit : float
        Seconds for the whole curve.
    **options :
        As for `place_beacons`: ``kind``, ``candidates``, ``spacing_m``, ``costs``, ``existing``, ``redundancy``,
        ``confidence``, ``forbidden``, ``min_spacing_m``, ``groups``, ``budget``, ``start_fix``.

    Returns
    -------
    tuple of Layout
        Fewest beacons first, worst drift falling; numbers of beacons that do not lower it are left out. The curve ends
        where a further beacon no longer helps by more than the tolerance, at ``up_to``, or when time is over.

    Examples
    --------
    >>> noise = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
    >>> tag = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01)
    >>> curve = beacon_tradeoff(None, [(0, 0), (60, 0)], noise, kind=tag, spacing_m=2.0, up_to=2)
    >>> [(len(layout.beacons), round(layout.worst_drift, 2)) for layout in curve]
    [(0, 2.96), (1, 0.99), (2, 0.53)]
    """
    whole("up_to", up_to, least=0)
    began = time.monotonic()
    curve: list[Layout] = []
    tracks: Tracks | None = None
    for count in range(up_to + 1):
        left = time_limit - (time.monotonic() - began)
        if left <= 0 and curve:
            break
        problem = placement_problem(world, routes, noise, max_beacons=count, **options)
        search = _Search(problem, time.monotonic(), max(left, 0.1), None, tracks)
        try:
            layout = search.least_drift(drift_tolerance, known=curve[-1] if curve else None)
        except InfeasibleError:  # groups may demand more beacons than these
            continue
        tracks = search.tracks
        if not curve or layout.worst_drift < curve[-1].worst_drift * (1 - drift_tolerance):
            curve.append(layout)
    if not curve:
        raise InfeasibleError(f"no layout of up to {up_to} beacons satisfies the groups and spacing asked for")
    return tuple(curve)


class _Search:
    """One problem, one clock."""

    def __init__(
        self,
        problem: PlacementProblem,
        began: float,
        time_limit: float,
        progress: Progress | None,
        tracks: Tracks | None = None,
    ):
        self.problem, self.began, self.progress = problem, began, progress
        check = _CHECK_S * len(problem.task.routes)
        self.deadline = began + max(time_limit - check, 0.75 * time_limit)
        self.tracks = tracks
        self.spans: Spans | None = None

    def cheapest(self, limits: tuple[float, ...]) -> Layout:
        self.tracks = self.problem.tracks(min(limits))
        cover = self._solve(limits)
        if cover.chosen is None:
            raise InfeasibleError(explain(self.problem, self.tracks, limits, cover, self._left()))
        proven = cover.outcome is Outcome.OPTIMAL
        return self._layout(cover.chosen, cover.lower_bound, proven, cover.outcome, limits, 0.0)

    def least_drift(self, tolerance: float, known: Layout | None = None) -> Layout:
        """Bisection over the limit: every step proves a limit out of reach or finds a layout below it."""
        if not 0 < tolerance < 1:
            raise ValueError(f"expected drift_tolerance in (0, 1), got {tolerance!r}")
        task, routes = self.problem.task, len(self.problem.task.routes)
        bare = max(task.worst(task.drift(r, self.problem.existing)) for r in range(routes))
        self.tracks = self.tracks or self.problem.tracks(self._finest(bare))
        best = self._allowed_layout()
        high = self._worst(best)
        low, outcome = 0.0, Outcome.OPTIMAL
        if known is not None:
            hint = self._as_sites(known)
            if self._worst(hint) <= high:
                best, high = hint, self._worst(hint)
        while high - low > tolerance * high:
            middle = 0.5 * (low + high)
            cover = self._solve((middle,) * routes, hint=best, stop_at_first=True)
            if cover.chosen is not None:
                best, high = cover.chosen, min(self._worst(cover.chosen), middle)
            elif cover.outcome is Outcome.INFEASIBLE:
                low = middle
            else:
                outcome = Outcome.STOPPED_EARLY
                break
        limits = (high * (1 + _ROUNDING),) * routes
        return self._layout(best, 0.0, outcome is Outcome.OPTIMAL, outcome, limits, low)

    def _solve(
        self, limits: Sequence[float], hint: NDArray[np.bool_] | None = None, stop_at_first: bool = False
    ) -> Cover:
        assert self.tracks is not None
        requirements = self.problem.requirements(self.tracks, limits)
        return cheapest_cover(
            self.problem.cost,
            requirements,
            demands=[*self.problem.demands, *requirements.rows()],
            caps=self.problem.caps,
            fixed=self.problem.fixed,
            hint=hint,
            stop_at_first=stop_at_first,
            time_limit=self._left(),
            progress=self._tell,
        )

    def _left(self) -> float:
        return max(self.deadline - time.monotonic(), 0.01)

    def _tell(self, _: float, cost: float, bound: float) -> None:
        if self.progress is not None:
            self.progress(time.monotonic() - self.began, cost, bound)

    def _finest(self, bare: float) -> float:
        """The smallest limit worth asking for: no beacon is better than its own accuracy."""
        stds = [b.kind.position_std_m or 0.0 for b in self.problem.sites]
        return max(min(stds) * 2**0.5, _FINEST * bare, 1e-6)

    def _allowed_layout(self) -> NDArray[np.bool_]:
        """A layout that satisfies groups and caps, whatever its drift."""
        problem = self.problem
        found = cheapest_cover(
            problem.cost,
            _Anything(),
            demands=problem.demands,
            caps=problem.caps,
            fixed=problem.fixed,
            time_limit=self._left(),
        )
        if found.chosen is None:
            raise InfeasibleError("no layout satisfies the groups together with " + ", ".join(problem.rules))
        return found.chosen

    def _as_sites(self, layout: Layout) -> NDArray[np.bool_]:
        ids = {b.id for b in layout.beacons}
        return np.array([b.id in ids for b in self.problem.sites]) | self.problem.fixed

    def _worst(self, chosen: NDArray[np.bool_]) -> float:
        """Greatest drift on any route, with the beacons dead that may be."""
        task, everyone = self.problem.task, (*self.problem.existing, *self.problem.chosen(chosen))
        if task.confidence is not None:
            return float(task.worst_of_failures(everyone, np.inf).max())
        assert self.tracks is not None
        self.spans = self.spans or Spans(self.tracks)
        drives = drives_of(self.tracks, chosen, np.arange(len(task.routes)), task.redundancy)
        return float(np.sqrt(worst_squares(self.spans, drives).max()))

    def _layout(
        self,
        chosen: NDArray[np.bool_],
        lower_bound: float,
        proven: bool,
        status: Outcome,
        limits: tuple[float, ...],
        drift_bound: float,
    ) -> Layout:
        """The layout, once the exact model has agreed that it keeps the limits.

        With all beacons alive that is `drift_with_beacons`; with some dead, drives on tables laid for this layout only.
        """
        problem, task = self.problem, self.problem.task
        everyone = (*problem.existing, *problem.chosen(chosen))
        drifts = tuple(task.drift(r, everyone) for r in range(len(limits)))
        worst = np.array([task.worst(drift) for drift in drifts])
        if task.redundancy > 1:
            worst = np.maximum(worst, task.worst_of_failures(everyone, min(limits)))
        rounding = _ROUNDING if task.confidence is None else _RADIUS_ROUNDING
        over = worst / np.array(limits)
        r = int(np.argmax(over))
        if over[r] > 1 + rounding:
            raise RuntimeError(
                f"the search accepted a layout whose drift on route {r} is {worst[r]:.9g} m, above {limits[r]:.9g} m, "
                f"with {task.redundancy - 1} of {[b.id for b in everyone]} dead: a bug in driftplan, please report it"
            )
        return Layout(
            beacons=problem.chosen(chosen),
            existing=problem.existing,
            cost=float(problem.cost @ chosen),
            lower_bound=lower_bound,
            proven=proven,
            status=status,
            max_drift=limits,
            drift_bound=drift_bound,
            drifts=drifts,
            seconds=time.monotonic() - self.began,
            task=task,
        )


class _Anything:
    """An oracle that accepts every layout."""

    def cuts(self, chosen: NDArray[np.bool_], near: int | None = None) -> list[Cut]:
        return []
