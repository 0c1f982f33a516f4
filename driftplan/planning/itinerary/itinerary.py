"""plan_itinerary: routes that use beacons so that the drift never exceeds a limit, or is least.

What is returned has been checked by the exact model (`driftplan.planning.itinerary.check`): everywhere on the way, with
every beacon dead that may be, and without beacons that the robot would probably miss. How it is found is told by
`driftplan.planning.itinerary.search`, what cannot be beaten by `driftplan.planning.bounds`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import BeaconColumns, DetectionChance
from driftplan.errors import InfeasibleError
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.planning.bounds import least_end_drift, least_length, least_worst_drift
from driftplan.planning.itinerary.reasons import why_infeasible
from driftplan.planning.itinerary.search import ROUNDING, ItinerarySearch, length_of
from driftplan.planning.roadmap.search import Status, check_connected, checked_ends
from driftplan.planning.routes import Route
from driftplan.world.world import World

Objective = Literal["length", "drift", "worst_drift"]

DEFAULT_DETOUR = 1.5
_SEARCH_SHARE = 0.75  # of the time limit; the rest is for shortening what was found


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Itinerary(Route):
    """A route that counts on beacons; `drift` has their readings in it.

    Attributes
    ----------
    minimise : {"length", "drift", "worst_drift"}
    bound : float
        Proven lower bound, over all routes, of what was minimised, metres. It takes no notice of obstacles, nor of
        ``redundancy`` and ``min_capture`` (`driftplan.planning.bounds`).
    beacons : tuple of Beacon
        Those it counts on, in the order of their first reading.
    captures : tuple of DetectionChance
        Every pass of a beacon and the probability that it happens.
    max_drift : float or None
        The limit asked for.
    worst_drift : float
        Greatest rms drift anywhere on the way, metres, all beacons alive.
    worst_if_dead : float
        The same, and with any one beacon dead where ``redundancy`` was 2.
    shortest_length : float
        Of the shortest route found, drift or not, metres.
    labels : int
        How many the search kept.
    seconds : float
    """

    minimise: Objective  # type: ignore[assignment]  # more than a Route can minimise
    beacons: tuple[Beacon, ...]
    captures: tuple[DetectionChance, ...]
    max_drift: float | None
    worst_drift: float
    worst_if_dead: float
    shortest_length: float
    labels: int
    seconds: float


def plan_itinerary(
    world: World,
    start: ArrayLike,
    goal: ArrayLike,
    noise: OdometryNoise,
    *,
    beacons: Sequence[Beacon],
    max_drift: float | None = None,
    minimise: Objective = "length",
    max_detour: float | None = None,
    redundancy: int = 1,
    min_capture: float = 0.9,
    initial: Fix | None = None,
    start_heading: float | None = None,
    nodes: int = 1000,
    time_limit: float = 5.0,
    seed: int = 0,
) -> Itinerary:
    """A route on which beacons keep the drift in check.

    Parameters
    ----------
    world : World
        Its walls block sight, its zones override ``noise``.
    start, goal : (2,)
        Metres, world frame.
    noise : OdometryNoise
        Of the continuous kind (no ``step_m``).
    beacons : sequence of Beacon
        May be empty: then the limit must hold without any.
    max_drift : float, optional
        Greatest rms drift, in metres, anywhere on the way.
    minimise : {"length", "drift", "worst_drift"}
        Length, rms drift at the goal, or the greatest rms drift on the way (to within about 2 %).
    max_detour : float, optional
        Greatest length as a multiple of the shortest route's, >= 1. Default: none for "length", else 1.5.
    redundancy : int
        2: all of it also holds with any one beacon dead, and what is minimised is the worst of those cases. 1: all are
        alive.
    min_capture : float in [0, 1)
        A beacon that the drifting robot would come within range of less surely than this on one of its passes
        (`driftplan.beacons.readings.detection_chances`) is not counted on.
    initial : Fix, optional
        Uncertainty at the start; default: the start is known.
    start_heading : float, optional
        Heading at the start, rad: then the first turn counts too.
    nodes : int
        Of the roadmap, about.
    time_limit : float
        Seconds; saying why there is no route may take as long again. Work is counted in labels and trials, and the
        time limit only cuts it short: `status` says when it did.
    seed : int
        Same seed, same route, unless the time limit was reached.

    Returns
    -------
    Itinerary

    Raises
    ------
    InfeasibleError
        If no route of the roadmap keeps the limit (or none was found in time): the message says how near it gets, and
        why.
    StartError, GoalError, NoPathError
        As `driftplan.plan_route`.
    ValueError
        For input that makes no sense.

    Examples
    --------
    >>> from driftplan.beacons.beacon import BeaconKind
    >>> world = World.from_polygons([], bounds=(0, 0, 60, 30), robot_radius=0.5)
    >>> noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
    >>> sign = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
    >>> asked = {"max_drift": 1.8, "nodes": 200, "time_limit": 60}
    >>> found = plan_itinerary(world, (2, 5), (58, 5), noise, beacons=[Beacon(sign, 30, 11)], **asked)
    >>> len(found.beacons), 56 < found.length < 62, found.worst_drift <= 1.8
    (1, True, True)
    """
    began = time.monotonic()
    ends = checked_ends(world, start, goal, noise, "length", time_limit, None, start_heading)
    check_options(
        beacons=beacons,
        max_drift=max_drift,
        minimise=minimise,
        max_detour=max_detour,
        redundancy=redundancy,
        min_capture=min_capture,
        initial=initial,
        nodes=nodes,
        seed=seed,
        noises=(noise, *(zone.noise for zone in world.zones)),
    )
    if (ends[0] == ends[1]).all():
        raise ValueError(f"expected start and goal apart, got {ends[0].tolist()} for both")
    check_connected(world, ends)
    search = ItinerarySearch(
        world,
        world,
        ends,
        noise,
        tuple(beacons),
        redundancy=redundancy,
        min_capture=min_capture,
        initial=initial,
        start_heading=start_heading,
        nodes=nodes,
        seed=seed,
        stop=lambda: time.monotonic() - began > _SEARCH_SHARE * time_limit,
        stop_shortening=lambda: time.monotonic() - began > time_limit,
    )
    longest = longest_of(search, minimise, max_detour)
    limit = math.inf if max_drift is None else float(max_drift)
    path = best_path(search, minimise, limit, longest)
    if path is None:
        search.stop = lambda: time.monotonic() - began > 2 * time_limit
        raise InfeasibleError(why_infeasible(search, limit, longest))
    return answer(search, path, minimise, max_drift, time.monotonic() - began)


def answer(
    search: ItinerarySearch, path: Floats, minimise: Objective, max_drift: float | None, seconds: float
) -> Itinerary:
    """The itinerary along a path that ``search`` found, from the exact model, with its bound."""
    check = search.check
    drift, verdict = check.drift(path), check.verdict(path)
    given = search.ends, search.kinds, search.beacons
    if minimise == "length":
        score, bound = float(drift.length), least_length(*given, max_drift)
    elif minimise == "drift":
        score, bound = verdict.end, least_end_drift(*given, verdict.end)
    else:
        score, bound = verdict.worst, least_worst_drift(*given, verdict.worst)
    status = Status.TIME_LIMIT if search.timed_out else Status.BATCHES_DONE
    if score <= bound * (1 + ROUNDING):
        status = Status.OPTIMAL
    return Itinerary(
        path=path,
        drift=drift,
        planner="roadmap",
        minimise=minimise,
        status=status,
        bound=min(bound, score),
        bound_covers="all routes",
        beacons=tuple(search.beacons[i] for i in check.met(path)),
        captures=tuple(check.captures(path)),
        max_drift=max_drift,
        worst_drift=replace(check, redundancy=1).verdict(path).worst,
        worst_if_dead=verdict.worst,
        shortest_length=length_of(search.shortest),
        labels=search.labels,
        seconds=seconds,
    )


def longest_of(search: ItinerarySearch, minimise: Objective, max_detour: float | None) -> float:
    """The greatest length that ``max_detour`` allows, metres."""
    if max_detour is None and minimise == "length":
        return math.inf
    return (max_detour or DEFAULT_DETOUR) * length_of(search.shortest) * (1 + ROUNDING)


def best_path(search: ItinerarySearch, minimise: Objective, limit: float, longest: float) -> Floats | None:
    """The best path that keeps the limit, or None."""
    if math.isfinite(limit) and least_length(search.ends, search.kinds, search.beacons, limit) > longest:
        return None  # whatever the roadmap
    if minimise == "length":
        return search.shortest_within(limit, longest)
    if minimise == "drift":
        return search.least_end_drift(limit, longest)
    return search.least_worst_drift(limit, longest)


def check_options(
    *,
    minimise: str,
    beacons: Sequence[Beacon] = (),
    max_drift: float | None = None,
    max_detour: float | None = None,
    redundancy: int = 1,
    min_capture: float = 0.0,
    initial: Fix | None = None,
    nodes: int = 1000,
    seed: int = 0,
    noises: Sequence[OdometryNoise] = (),
) -> None:
    """Refuse, with a ValueError, what itineraries cannot be planned with."""
    if minimise not in get_args(Objective):
        raise ValueError(f"expected minimise one of {get_args(Objective)}, got {minimise!r}")
    if any(kind.step_m is not None for kind in noises):
        raise ValueError(
            "expected noise of the continuous kind, got noise per step (step_m), which depends on how a path is cut"
        )
    BeaconColumns.of(beacons)
    if max_drift is not None and not (math.isfinite(max_drift) and max_drift > 0):
        raise ValueError(f"expected max_drift finite and > 0 m, got {max_drift!r}")
    if max_detour is not None and not (math.isfinite(max_detour) and max_detour >= 1):
        raise ValueError(f"expected max_detour >= 1, got {max_detour!r}")
    if redundancy not in (1, 2):
        raise ValueError(f"expected redundancy 1 (all beacons live) or 2 (any one may be dead), got {redundancy!r}")
    if not 0 <= min_capture < 1:
        raise ValueError(f"expected min_capture in [0, 1), got {min_capture!r}")
    if initial is not None and not (isinstance(initial, Fix) and initial.s_m == 0):
        raise ValueError(f"expected initial a Fix at s_m=0, got {initial!r}")
    for name, value, least in (("nodes", nodes, 10), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
            raise ValueError(f"expected {name} a whole number >= {least}, got {value!r}")
