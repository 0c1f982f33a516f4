"""A roadmap on which every directed edge knows what driving it does to a robot's drift, beacons on the way included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from driftplan.arrays import Complexes, Floats, Ints
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import BeaconColumns
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import wrap
from driftplan.model.readings import Estimator, Fix
from driftplan.planning.roadmap.edge_steps import NO_SITE, Steps, edge_steps
from driftplan.planning.roadmap.fused_edges import FusedEdges, FusedEffects
from driftplan.planning.roadmap.graph import GOAL
from driftplan.planning.roadmap.reset_edges import ResetEdges, ResetEffects
from driftplan.world.world import World
from driftplan.world.zones import noises_on

Effects = ResetEffects | FusedEffects  # what driving edges does to the errors


@dataclass(frozen=True, eq=False)
class BeaconGraph:
    """Nodes (n, 2) and directed edges sorted by where they leave, with their `Effects`."""

    xy: Floats
    first: Ints  # (n + 1,) where the edges out of each node begin
    tail: Ints
    head: Ints
    direction: Complexes  # (m,) unit complex numbers
    length: Floats  # (m,) metres
    effects: Effects  # with all beacons alive
    noise: OdometryNoise
    beacons: tuple[Beacon, ...]
    world: World | None
    errors: ResetEdges | FusedEdges = field(repr=False)  # what the robot's estimator makes of runs, turns and readings
    _steps: Steps = field(repr=False)
    _turns: dict[complex, dict[int, Floats]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls,
        xy: Floats,
        edges: Ints,
        noise: OdometryNoise,
        beacons: Sequence[Beacon],
        world: World | None,
        estimator: Estimator = "reset",
    ) -> BeaconGraph:
        """The roadmap over nodes ``xy`` (n, 2) and undirected ``edges`` (m, 2)."""
        tail = np.concatenate([edges[:, 0], edges[:, 1]]).astype(np.intp)
        head = np.concatenate([edges[:, 1], edges[:, 0]]).astype(np.intp)
        order = np.lexsort((head, tail))
        tail, head = tail[order], head[order]
        vector = (xy[head] - xy[tail]) @ np.array([1.0, 1j])
        length = np.abs(vector)
        steps = edge_steps(xy[tail], vector / length, length, head == GOAL, BeaconColumns.of(beacons), world)
        kind = FusedEdges if estimator == "filter" else ResetEdges
        errors = kind(steps, noises_on(world, noise), beacons)
        return cls(
            xy=xy,
            first=np.searchsorted(tail, np.arange(len(xy) + 1)),
            tail=tail,
            head=head,
            direction=vector / length,
            length=length,
            effects=errors.effects(np.arange(len(tail))),
            noise=noise,
            beacons=tuple(beacons),
            world=world,
            errors=errors,
            _steps=steps,
        )

    def without(self, site: int) -> Effects:
        """Effects of the edges on which a beacon is read, were it dead; with as many rows as when it is alive."""
        return self.errors.effects(np.unique(self._steps.edge[self._steps.site == site]), site)

    def at_start(self, node: int, initial: Fix | None, dead: int = NO_SITE) -> Floats:
        """The error state (9,) of a robot that begins at a node: known exactly or as ``initial`` says, after reading
        what is in range and always noticed."""
        x = self.errors.at_start(initial)
        columns = BeaconColumns.of(self.beacons)
        here = np.broadcast_to(self.xy[node], columns.xy.shape)
        inside = np.hypot(*(columns.xy - here).T) <= columns.range_m
        inside &= columns.detection_probability == 1
        if self.world is not None:
            asked = inside & columns.must_see
            inside[asked] = self.world.line_of_sight(here[asked], columns.xy[asked])
        inside &= columns.views.sensor_half_angle >= np.pi  # whoever stands does not know yet where it will look
        inside &= columns.views.at(np.arange(len(inside)), here - columns.xy, np.zeros(len(inside)))
        for site in sorted(np.flatnonzero(inside).tolist(), key=lambda i: int(columns.rank[i])):
            if site != dead:
                x = self.errors.read(x, site, complex(*self.xy[node]))
        return x

    @property
    def turns_matter(self) -> bool:
        return self.errors.turns_matter or any(x.turns_matter for x in noises_on(self.world, self.noise))

    def worst_turn(self) -> tuple[float, float]:
        """Heading and position variance per radian turned, at most."""
        noises = noises_on(self.world, self.noise)
        return max(x.heading_var_per_rad for x in noises), max(x.distance_var_per_rad for x in noises)

    def turned(self, node: int, arriving: complex, states: Floats) -> Floats:
        """States (k, 9, s) after turning from a direction to each edge out of a node, from states (9, s)."""
        known = self._turns.setdefault(arriving, {})
        if node not in known:
            away = self.direction[self.first[node] : self.first[node + 1]]
            turn_rad = wrap(np.angle(away) - np.angle(arriving))
            noises, which = noises_on(self.world, self.noise), 1 + self._zone_after(node, away)
            parts = np.unique(which).tolist()
            done = [self.errors.turns(turn_rad[which == k], arriving, noises[k]) for k in parts]
            order = np.concatenate([np.flatnonzero(which == k) for k in parts])
            known[node] = np.concatenate(done)[np.argsort(order)]
        return self.errors.turned(states, known[node])

    def _zone_after(self, node: int, away: Complexes) -> Ints:
        """Zone just after the node on each edge out of it; -1 for none."""
        if self.world is None or not self.world.zones:
            return np.full(len(away), -1, dtype=np.intp)
        points = self.xy[node] + 1e-6 * np.stack([away.real, away.imag], axis=-1)
        return np.asarray(self.world.zone_at(points), dtype=np.intp)
