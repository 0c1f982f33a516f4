"""A roadmap as the exact search sees it, and what the additive cost alone proves about it."""

from __future__ import annotations

from math import inf

import numpy as np

from driftplan.model.noise import OdometryNoise
from driftplan.planning.cost import bracket
from driftplan.planning.exact_cost import Prepending, identity, run_maps, turn_maps, turns_matter
from driftplan.planning.exact_search import SearchGraph
from driftplan.planning.roadmap_graph import GOAL, START, Roadmap, Transitions
from driftplan.planning.roadmap_pricing import Floats, Space

_GRID = 4000  # heading variances at which the additive bound is evaluated


def is_plain(noise: OdometryNoise, space: Space) -> bool:
    """Whether the noise is white along the path, without systematic or correlated parts, wherever the robot is: what
    the additive cost prices in full, so that its brackets hold."""
    kinds = (noise, *(zone.noise for zone in space.zones))
    return not any(k.step_m is not None or k.is_systematic or k.heading_distance_corr for k in kinds)


def search_graph(roadmap: Roadmap, noise: OdometryNoise, most_heading_var: float) -> SearchGraph:
    """The roadmap seen from the goal, for paths that gain at most ``most_heading_var`` (rad²) of heading variance."""
    space, goal = roadmap.pricing.space, roadmap.xy[GOAL]
    moves = roadmap.transitions() if turns_matter(noise, space) else None
    tail = np.concatenate([roadmap.edges[:, 0], roadmap.edges[:, 1]])
    head = np.concatenate([roadmap.edges[:, 1], roadmap.edges[:, 0]])
    runs = run_maps(space, noise, goal, roadmap.xy[tail], roadmap.xy[head])
    to_goal, _ = roadmap.distances(roadmap.prices.heading_var, GOAL)
    limited = is_plain(noise, space) and most_heading_var < inf
    room = most_heading_var - to_goal if limited else np.full(len(roadmap.xy), inf)
    farthest = float(np.linalg.norm(roadmap.xy - goal, axis=1).max())
    if moves is not None:
        return _with_turns(roadmap, noise, moves, runs, room, farthest)
    useful = (head != START) & (tail != GOAL) & (room[tail] >= 0)
    to_come, _ = roadmap.distances(roadmap.prices.cost, START)
    return SearchGraph(
        begin=head[useful],
        end=tail[useful],
        maps=runs.pick(useful),
        node=np.arange(len(roadmap.xy)),
        to_come=to_come,
        heading_room=room,
        source=GOAL,
        target=START,
        farthest=farthest,
    )


def _with_turns(
    roadmap: Roadmap, noise: OdometryNoise, moves: Transitions, runs: Prepending, room: Floats, farthest: float
) -> SearchGraph:
    """States are directed edges, 'this edge and what follows it', then the goal, then the start.

    The turn between two edges is prepended together with the first of them.
    """
    space, goal = roadmap.pricing.space, roadmap.xy[GOAL]
    source, target = len(moves.tail), len(moves.tail) + 1
    step = (roadmap.xy[moves.head] - roadmap.xy[moves.tail]) @ np.array([1.0, 1j])
    direction = step / np.abs(step)
    last = np.flatnonzero((moves.head == GOAL) & (moves.tail != GOAL))
    # Paths neither come back to the start nor leave the goal.
    inner = (moves.tail[moves.after] != START) & (moves.tail[moves.after] != GOAL) & (moves.tail[moves.before] != GOAL)
    before, after = moves.before[inner], moves.after[inner]
    turns = turn_maps(
        space, noise, goal, roadmap.xy[moves.tail[after]], direction[before], moves.turn_rad[inner], moves.zone[after]
    )
    leaving, first_turn, _ = roadmap.first_turns(moves)
    facing = direction[leaving] * np.exp(-1j * first_turn)
    first = (
        identity(len(leaving))
        if roadmap.start_heading is None
        else turn_maps(space, noise, goal, roadmap.xy[moves.tail[leaving]], facing, first_turn, moves.zone[leaving])
    )
    maps = (runs.pick(last), runs.pick(before).after(turns), first)
    cost = roadmap.costs_of_edges(moves)
    room_of_edge = np.concatenate([room[moves.tail], room[[GOAL, START]]])
    begin = np.concatenate([np.full(len(last), source), after, leaving])
    end = np.concatenate([last, before, np.full(len(leaving), target)])
    useful = room_of_edge[end] >= 0
    arriving = cost[np.flatnonzero(moves.head == GOAL)]
    return SearchGraph(
        begin=begin[useful],
        end=end[useful],
        maps=Prepending(*(np.concatenate(columns) for columns in zip(*maps, strict=True))).pick(useful),
        node=np.concatenate([moves.tail, [-1, -1]]),
        to_come=np.concatenate([np.maximum(cost - moves.cost, 0.0), [arriving.min(initial=inf), 0.0]]),
        heading_room=room_of_edge,
        source=source,
        target=target,
        farthest=farthest,
    )


def additive_bound(roadmap: Roadmap, noise: OdometryNoise, most_heading_var: float) -> float:
    """A lower bound of E|e|² (m²) over all paths of the roadmap that gain at most ``most_heading_var`` (rad²).

    A path of heading variance H, heading cost J_h and position cost J_p has ``E|e|² >= Λ(H) J_h + J_p``. With the
    least J and J_h on the roadmap, and the least position cost r per heading variance of any of its edges and a turn,
    that is at least ``max(Λ(H) min J, Λ(H) min J_h + r H)``, whose least value over H is returned. Zero where the
    noise is not plain.
    """
    if not is_plain(noise, roadmap.pricing.space):
        return 0.0
    prices = roadmap.prices
    least = roadmap.shortest().cost
    if not least < inf:
        return inf
    heading_cost, _ = roadmap.distances(np.maximum(prices.cost - prices.position, 0.0), START)
    heading_var, _ = roadmap.distances(prices.heading_var, START)
    gained = prices.heading_var + np.pi * roadmap.pricing.worst_turn
    rate = float(np.min(prices.position / np.where(gained > 0, gained, 1e-300)))
    low = float(heading_var[GOAL])
    high = min(most_heading_var, max(low, least / rate) if rate > 0 else inf)  # beyond, r H alone is enough
    if high == inf:
        return 0.0
    if high <= low:
        return least * float(bracket(high**0.5))
    grid = np.geomspace(max(low, 1e-9 * high), high, _GRID)
    grid[0] = low
    weight = bracket(np.sqrt(grid[1:]))  # Λ falls and r H rises: both at their least in every interval
    return float(np.maximum(weight * least, weight * heading_cost[GOAL] + rate * grid[:-1]).min())
