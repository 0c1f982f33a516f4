"""Prices of straight motions and turns towards one goal, in bulk, on floors of one or several kinds.

Edges that cross zones are cut where the zone changes and priced piece by piece, which is exact since the additive cost
does not mind the cutting. A turn on the spot is priced with the noise of the run that follows it, as `predict_drift`
does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, field
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Bools, Floats, Ints
from driftplan.model.drift import Drift, predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.planning.cost import CostRates, edge_cost, geodesic_cost, turn_cost
from driftplan.world.world import World
from driftplan.world.zones import Zone, ZonePieces, noises_on

Score = Literal["drift", "length"]

_LENGTH = CostRates(heading=0.0, position=1.0)


class Space(Protocol):
    """What the roadmap asks of the world: a `World`, or anything else that can say where the robot may drive."""

    @property
    def bounds(self) -> tuple[float, float, float, float]: ...
    @property
    def zones(self) -> tuple[Zone, ...]: ...
    def is_free(self, xy: Floats, /) -> Bools: ...
    def segments_free(self, a: Floats, b: Floats, /) -> Bools: ...
    def corners(self, tolerance_m: float | None = None, /) -> Floats: ...
    def zone_pieces(self, a: Floats, b: Floats, /) -> ZonePieces: ...


class PartOfWorld:
    """A world within a box (xmin, ymin, xmax, ymax), metres, and with the noise of other zones at the same places."""

    def __init__(self, world: World, box: tuple[float, float, float, float], zones: tuple[Zone, ...]) -> None:
        low, high = np.maximum(box[:2], world.bounds[:2]), np.minimum(box[2:], world.bounds[2:])
        self.bounds: tuple[float, float, float, float] = (*low.tolist(), *high.tolist())
        self.zones = zones
        self.robot_radius = world.robot_radius
        self.world, self._low, self._high = world, low, high

    def is_free(self, xy: Floats, /) -> Bools:
        return np.asarray(((xy >= self._low) & (xy <= self._high)).all(axis=-1) & self.world.is_free(xy))

    def segments_free(self, a: Floats, b: Floats, /) -> Bools:
        return self.world.segments_free(a, b)  # their ends are in the box, which is convex

    def corners(self, tolerance_m: float | None = None, /) -> Floats:
        corners = self.world.corners(tolerance_m)
        return corners[self.is_free(corners)]

    def zone_pieces(self, a: Floats, b: Floats, /) -> ZonePieces:
        return self.world.zone_pieces(a, b)


class EdgePrices(NamedTuple):
    """Prices of straight edges from a to b, the same in both directions."""

    cost: Floats  # (n,) m², or m for the length
    zone_a: Ints  # (n,) index of the zone in which the edge leaves a, -1 for none,
    zone_b: Ints  # (n,) and in which it reaches b

    def pick(self, which: NDArray[Any]) -> EdgePrices:
        """The prices of some of the edges."""
        return EdgePrices(*(column[which] for column in self))

    def joined(self, other: EdgePrices) -> EdgePrices:
        """These prices, then the others."""
        return EdgePrices(*(np.concatenate(columns) for columns in zip(self, other, strict=True)))


@dataclass(frozen=True, eq=False)
class AdditiveCost:
    """The additive cost of motions towards ``goal`` in ``space``: expected squared drift (m²) or length (m)."""

    space: Space
    goal: Floats
    noise: OdometryNoise
    minimise: Score = "drift"
    _rates: Floats = field(init=False, repr=False)  # (n, 4) of everywhere else, and of the zones
    _floor: CostRates = field(init=False, repr=False)  # the least of all

    def __post_init__(self) -> None:
        kinds = {noise: astuple(CostRates.of(noise)) for noise in set(self.noises)}
        rates = np.array([astuple(_LENGTH)] if self.minimise == "length" else [kinds[noise] for noise in self.noises])
        object.__setattr__(self, "_rates", rates)
        object.__setattr__(self, "_floor", CostRates(*rates.min(axis=0).tolist()))

    @property
    def noises(self) -> tuple[OdometryNoise, ...]:
        """The noise outside all zones, then that of every zone."""
        return noises_on(self.space, self.noise)

    @property
    def has_zones(self) -> bool:
        return len(self._rates) > 1

    @property
    def has_turns(self) -> bool:
        """Whether turning on the spot costs anything, so that an edge's price depends on the one before."""
        return bool((self._rates[:, 2:] > 0).any())

    def edges(self, a: Floats, b: Floats) -> EdgePrices:
        """Prices of the edges from ``a`` to ``b``, (n, 2) each."""
        if not self.has_zones:
            nowhere = np.full(len(a), -1, dtype=np.int64)
            return EdgePrices(edge_cost(a, b, self.goal, self._at(-1)), nowhere, nowhere)
        pieces = self.space.zone_pieces(a, b)
        step = (b - a)[pieces.segment]
        begin = a[pieces.segment] + pieces.start[:, None] * step
        end = a[pieces.segment] + pieces.end[:, None] * step
        prices = edge_cost(begin, end, self.goal, self._at(pieces.zone))
        cost = np.bincount(pieces.segment, weights=prices, minlength=len(a)).astype(float)
        first = np.searchsorted(pieces.segment, np.arange(len(a)))
        last = np.searchsorted(pieces.segment, np.arange(len(a)), side="right") - 1
        return EdgePrices(cost, pieces.zone[first], pieces.zone[last])

    def turns(self, at: Floats, turn_rad: Floats, zone: Ints) -> Floats:
        """Prices of turns on the spot at ``at`` (n, 2), before runs that begin in ``zone`` (n,)."""
        return turn_cost(at, turn_rad, self.goal, self._at(zone))

    def path(self, xy: Floats, start_heading: float | None = None) -> float:
        """Price of a polyline (n, 2) without repeated points."""
        prices = self.edges(xy[:-1], xy[1:])
        total = float(prices.cost.sum())
        if self.has_turns:
            total += float(self.turns(xy[:-1], turn_angles(xy, start_heading), prices.zone_a).sum())
        return total

    def lower_bound(self, a: Floats, b: Floats) -> Floats:
        """What any motion from ``a`` to ``b`` costs at least, obstacles or not: the best floor everywhere, no turns."""
        return geodesic_cost(a, b, self.goal, self._floor)

    def _at(self, zone: Ints | int) -> CostRates:
        """The rates of a zone, or of one for each item."""
        return CostRates(*self._rates[zone + 1].T)


def exact_drift(
    space: Space, path: Floats, noise: OdometryNoise, start_heading: float | None = None, fixes: Sequence[Fix] = ()
) -> Drift:
    """`predict_drift` along a polyline (n, 2), each stretch with the noise of the zone it is in."""
    if not space.zones:
        return predict_drift(path, noise, fixes=fixes, start_heading=start_heading)
    pieces = space.zone_pieces(path[:-1], path[1:])
    noises = noises_on(space, noise)
    legs = [noises[zone + 1] for zone in pieces.zone.tolist()]
    return predict_drift(pieces.cut(path), legs, fixes=fixes, start_heading=start_heading)


def turn_angles(xy: Floats, start_heading: float | None) -> Floats:
    """Angle in [-π, π] turned before each leg of a polyline (n, 2) without repeated points; shape (n - 1,)."""
    step = xy[1:, 0] - xy[:-1, 0] + 1j * (xy[1:, 1] - xy[:-1, 1])
    facing = step[:1] if start_heading is None else np.exp(1j * np.array([start_heading]))
    return np.asarray(np.angle(step * np.conj(np.concatenate([facing, step[:-1]]))))


def length_of(path: Floats) -> float:
    """Of a polyline (n, 2), metres."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
