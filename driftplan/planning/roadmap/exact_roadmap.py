"""A roadmap for the exact search, and what the additive cost alone proves about it."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Complexes, Floats, Ints
from driftplan.model.noise import OdometryNoise
from driftplan.planning.cost import bracket
from driftplan.planning.roadmap.exact_cost import Prepending, run_maps, turn_maps, turns_matter
from driftplan.planning.roadmap.exact_greedy import greedily_best
from driftplan.planning.roadmap.exact_search import MOST_LABELS, SearchGraph, least_exact_cost
from driftplan.planning.roadmap.graph import GOAL, START, Roadmap, Transitions
from driftplan.planning.roadmap.prices import Space

GAP = 1e-3  # relative: a search ends when its bound is this close
TIMES = 2.0  # the heading standard deviation of the path found: bounds are sought for paths of up to so much
_GRID = 4000  # heading variances at which the additive bound is evaluated


def is_plain(noise: OdometryNoise, space: Space) -> bool:
    """Whether the noise is white along the path, without systematic or correlated parts, wherever the robot is: what
    the additive cost prices in full, so that its brackets hold."""
    kinds = (noise, *(zone.noise for zone in space.zones))
    return not any(k.step_m is not None or k.is_systematic or k.heading_distance_corr for k in kinds)


def search_graph(roadmap: Roadmap, noise: OdometryNoise, most_heading_var: float, upper: float = inf) -> SearchGraph:
    """The roadmap as a `SearchGraph`, for paths that gain at most ``most_heading_var`` (rad²) of heading variance.

    When turns matter, edges are left out that no path with E|e|² below ``upper`` can use.
    """
    space, goal = roadmap.pricing.space, roadmap.xy[GOAL]
    moves = None
    if turns_matter(noise, space):
        bracketed = is_plain(noise, space) and most_heading_var < inf
        moves = roadmap.transitions(upper / float(bracket(most_heading_var**0.5)) if bracketed else inf)
    tail, head = roadmap.edges.T.ravel(), roadmap.edges[:, ::-1].T.ravel()
    if moves is not None:
        tail, head = moves.tail, moves.head
    runs = run_maps(space, noise, goal, roadmap.xy[tail], roadmap.xy[head])
    from_start, _ = roadmap.distances(roadmap.prices.heading_var, START)
    limited = is_plain(noise, space) and most_heading_var < inf
    room = most_heading_var * (1 + 1e-9) - from_start if limited else np.full(len(roadmap.xy), inf)
    farthest = float(np.linalg.norm(roadmap.xy - goal, axis=1).max())
    if moves is not None:
        return _with_turns(roadmap, noise, moves, runs, room, farthest)
    useful = (head != START) & (tail != GOAL) & (room[head] >= 0)
    to_go, _ = roadmap.distances(roadmap.prices.cost, GOAL)
    return SearchGraph(
        begin=tail[useful],
        end=head[useful],
        maps=runs.pick(useful),
        node=np.arange(len(roadmap.xy)),
        to_go=to_go,
        heading_room=room,
        source=START,
        target=GOAL,
        farthest=farthest,
    )


def _with_turns(
    roadmap: Roadmap, noise: OdometryNoise, moves: Transitions, runs: Prepending, room: Floats, farthest: float
) -> SearchGraph:
    """States are directed edges, 'this edge has been driven', then the start, then the goal.

    The turn between two edges is driven together with the second of them.
    """
    space, goal = roadmap.pricing.space, roadmap.xy[GOAL]
    source, target = len(moves.tail), len(moves.tail) + 1
    step = (roadmap.xy[moves.head] - roadmap.xy[moves.tail]) @ np.array([1.0, 1j])
    direction = step / np.abs(step)

    def turned(edge: Ints, facing: Complexes, turn_rad: Floats) -> Prepending:
        at, zone = roadmap.xy[moves.tail[edge]], moves.zone[edge]
        return turn_maps(space, noise, goal, at, facing, turn_rad, zone).after(runs.pick(edge))

    # Paths neither come back to the start nor leave the goal.
    ends = (START, GOAL)
    inner = ~np.isin(moves.tail[moves.after], ends) & (moves.head[moves.after] != START)
    before, after = moves.before[inner], moves.after[inner]
    onward = turned(after, direction[before], moves.turn_rad[inner])
    leaving, first_turn, first_cost = roadmap.first_turns(moves)
    if roadmap.start_heading is None:
        away = runs.pick(leaving)
    else:
        away = turned(leaving, direction[leaving] * np.exp(-1j * first_turn), first_turn)
    state = np.where(moves.head == GOAL, target, np.arange(source))
    begin = np.concatenate([before, np.full(len(leaving), source)])
    end = state[np.concatenate([after, leaving])]
    room_of_state = np.concatenate([room[moves.head], room[[START, GOAL]]])
    useful = room_of_state[end] >= 0
    to_go = roadmap.costs_after_edges(moves)
    return SearchGraph(
        begin=begin[useful],
        end=end[useful],
        maps=Prepending(*(np.concatenate(columns) for columns in zip(onward, away, strict=True))).pick(useful),
        node=np.concatenate([moves.head, [-1, -1]]),
        to_go=np.concatenate([to_go, [(first_cost + moves.cost[leaving] + to_go[leaving]).min(initial=inf), 0.0]]),
        heading_room=room_of_state,
        source=source,
        target=target,
        farthest=farthest,
    )


def additive_bound(
    roadmap: Roadmap, noise: OdometryNoise, least_var: float, most_var: float, known: float = inf
) -> float:
    """A lower bound of E|e|² (m²) over all paths of the roadmap whose heading variance H is in a range (rad²).

    Such a path has ``E|e|² >= Λ(H) J_h + J_p`` with its heading and position cost. With the least J and J_h on the
    roadmap, and the least position cost r per heading variance of any of its edges and a turn, that is at least
    ``max(Λ(H) min J, Λ(H) min J_h + r H)``, whose least value over H is returned. Zero where the noise is not plain.
    ``known`` is the additive cost of some path: no need to look at dearer ones for min J.
    """
    if not is_plain(noise, roadmap.pricing.space):
        return 0.0
    return _additive_bound(roadmap, min(roadmap.shortest(known).cost, known), least_var, most_var)


def _additive_bound(roadmap: Roadmap, least: float, least_var: float, most_var: float) -> float:
    """`additive_bound` for plain noise, the least additive cost on the roadmap being known."""
    prices = roadmap.prices
    if not least < inf:
        return inf
    heading_cost = roadmap.distances(np.maximum(prices.cost - prices.position, 0.0), START)[0][GOAL]
    low = max(least_var, roadmap.distances(prices.heading_var, START)[0][GOAL])
    gained = prices.heading_var + np.pi * roadmap.pricing.worst_turn
    rate = float(np.min(prices.position / np.where(gained > 0, gained, 1e-300)))
    high = min(most_var, max(low, least / rate) if rate > 0 else inf)  # beyond, r H alone is enough
    if high == inf:
        return 0.0
    if high <= low:
        return least * float(bracket(high**0.5))
    grid = np.geomspace(max(low, 1e-9 * high), high, _GRID)
    grid[0] = low
    weight = bracket(np.sqrt(grid[1:]))  # Λ falls and r H rises: both at their least in every interval
    return float(np.maximum(weight * least, weight * heading_cost + rate * grid[:-1]).min())


class Bound(NamedTuple):
    """No path of a roadmap that gains a heading standard deviation of at most ``heading_std`` rad costs less."""

    mean_square: float  # m²
    heading_std: float  # rad; infinite where it holds for all paths


def bracketed(roadmap: Roadmap, noise: OdometryNoise, heading_std: float, known: float = inf) -> Bound:
    """What the additive cost proves: for all paths, or for those with up to twice the ``heading_std`` of one found."""
    most = (TIMES * heading_std) ** 2
    if not is_plain(noise, roadmap.pricing.space):
        return Bound(0.0, inf)
    least = min(roadmap.shortest(known).cost, known)
    return _beyond(roadmap, least, most, _additive_bound(roadmap, least, 0.0, most))


def probably_best(roadmap: Roadmap, noise: OdometryNoise) -> Floats | None:
    """A simple path of the roadmap with little E|e|², found quickly; see `driftplan.planning.roadmap.exact_greedy`."""
    graph = search_graph(roadmap, noise, inf)
    states = greedily_best(graph)
    return None if states is None else _path(roadmap, graph, states)


def exactly_best(
    roadmap: Roadmap,
    noise: OdometryNoise,
    path_cost: float,
    heading_std: float,
    stop: Callable[[], bool] = lambda: False,
    known: float = inf,
    most_labels: int = MOST_LABELS,
) -> tuple[Floats | None, Bound, bool]:
    """The simple path of the roadmap with the least E|e|², if below ``path_cost``; a bound; whether that is proven.

    A first search lets paths visit nodes twice, which is quick and nearly always answers with one that does not. If it
    does not end so, a second one forbids it. What the first one proved holds all the same.
    """
    most = (TIMES * heading_std) ** 2
    graph = search_graph(roadmap, noise, most, path_cost)
    plain = is_plain(noise, roadmap.pricing.space)
    least = min(roadmap.shortest(known).cost, known) if plain else inf
    best: Floats | None = None
    bound, finished = _additive_bound(roadmap, least, 0.0, most) if plain else 0.0, False
    anything = np.zeros(0, dtype=np.int64)
    for memory in (anything, None):
        found = least_exact_cost(graph, upper=path_cost, gap=GAP, memory=memory, stop=stop, most_labels=most_labels)
        bound, finished = max(bound, found.bound), found.finished
        if found.states is None:
            if finished:
                break
            continue
        path = _path(roadmap, graph, found.states)
        if path is not None:
            best, path_cost = path, found.cost
            if finished:
                break
    if not plain:
        return best, Bound(bound, inf), finished
    return best, _beyond(roadmap, least, most, bound), finished


def _path(roadmap: Roadmap, graph: SearchGraph, states: Ints) -> Floats | None:
    """The waypoints of a path of the graph, if it is simple."""
    nodes = states.copy() if graph.source == START else graph.node[states]
    nodes[[0, -1]] = START, GOAL
    return roadmap.xy[nodes] if len(np.unique(nodes)) == len(nodes) else None


def _beyond(roadmap: Roadmap, least: float, most_var: float, bound: float) -> Bound:
    """A bound for paths of heading variance up to ``most_var``; for all of them where the others cannot be better."""
    everywhere = most_var == inf or _additive_bound(roadmap, least, most_var, inf) >= bound
    return Bound(bound, inf if everywhere else most_var**0.5)
