"""plan_route as scripts know it: with beacons or a limit on the drift an itinerary, without them a plain route."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from numpy.typing import ArrayLike

from driftplan.beacons.beacon import Beacon
from driftplan.errors import PlannerError
from driftplan.model.noise import OdometryNoise
from driftplan.planning import routes
from driftplan.planning.itinerary.itinerary import Objective, plan_itinerary
from driftplan.planning.routes import ROADMAP, Route
from driftplan.world.world import World


def plan_route(
    world: World,
    start: ArrayLike,
    goal: ArrayLike,
    noise: OdometryNoise,
    *,
    beacons: Sequence[Beacon] = (),
    minimise: Objective = "drift",
    max_drift: float | None = None,
    max_detour: float | None = None,
    planner: str = ROADMAP,
    candidates: Iterable[ArrayLike] = (),
    start_heading: float | None = None,
    time_limit: float | None = None,
    iterations: int | None = None,
    seed: int = 0,
    **itinerary_options: Any,
) -> Route:
    """The route on which odometry drifts least, or the shortest one, with beacons on the way if there are any.

    Without beacons, without ``max_drift`` and unless the worst drift is to be least this is
    `driftplan.planning.routes.plan_route`, whose parameters and errors hold; otherwise
    `driftplan.planning.itinerary.itinerary.plan_itinerary`.

    Parameters
    ----------
    world, start, goal, noise, max_detour, start_heading, seed :
        As there. With beacons ``max_detour`` is 1.5 by default, unless length is minimised: a full fix wipes the past,
        so the least drift alone would send the robot to the beacon next to the goal however far that is.
    beacons : sequence of Beacon
    minimise : {"drift", "length", "worst_drift"}
        rms drift at the goal, length, or the greatest rms drift on the way.
    max_drift : float, optional
        Greatest rms drift anywhere on the way, metres.
    planner : str
        Itineraries know "roadmap" only.
    candidates : iterable of (n, 2)
        Other paths to be considered, for plain routes.
    time_limit : float, optional
        Seconds; default 1 for plain routes, 5 for itineraries.
    iterations : int, optional
        Of the search, for plain routes: then the same seed gives the same route, to the last bit.
    **itinerary_options :
        ``redundancy``, ``min_capture``, ``initial``, ``nodes`` of `plan_itinerary`.

    Returns
    -------
    Route
        An `Itinerary` where beacons, a limit or the worst drift are involved.

    Raises
    ------
    PlannerError
        If an itinerary is asked of another planner than "roadmap".
    ValueError
        If candidates or ``iterations`` are given for an itinerary, or itinerary options for a plain route.

    Examples
    --------
    >>> from driftplan.beacons.beacon import BeaconKind
    >>> world = World.from_polygons([], bounds=(0, 0, 60, 30), robot_radius=0.5)
    >>> noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
    >>> plan_route(world, (2, 5), (58, 5), noise, minimise="length").length
    56.0
    >>> sign = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
    >>> plan_route(world, (2, 5), (58, 5), noise, beacons=[Beacon(sign, 30, 6)], max_drift=2, minimise="length").length
    56.0
    """
    if not beacons and max_drift is None and minimise != "worst_drift":
        if itinerary_options:
            raise ValueError(f"expected beacons or max_drift together with {sorted(itinerary_options)}, got neither")
        return routes.plan_route(
            world,
            start,
            goal,
            noise,
            minimise=minimise,
            planner=planner,
            max_detour=max_detour,
            candidates=candidates,
            start_heading=start_heading,
            time_limit=time_limit,
            iterations=iterations,
            seed=seed,
        )
    if planner != ROADMAP:
        raise PlannerError(f"expected planner={ROADMAP!r} for routes with beacons or max_drift, got {planner!r}")
    if iterations is not None:
        raise ValueError("expected no iterations for routes with beacons or max_drift: give a time_limit")
    if list(candidates):
        raise ValueError("expected no candidates for routes with beacons or max_drift: they are searched for")
    return plan_itinerary(
        world,
        start,
        goal,
        noise,
        beacons=beacons,
        max_drift=max_drift,
        minimise=minimise,
        max_detour=max_detour,
        start_heading=start_heading,
        time_limit=5.0 if time_limit is None else time_limit,
        seed=seed,
        **itinerary_options,
    )
