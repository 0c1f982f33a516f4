"""What label searches ask about a robot's errors, whatever its estimator makes of readings.

An error state is a column of nine numbers; states of several scenarios of dead beacons stand side by side, (9, s). See
`driftplan.planning.roadmap.reset_edges` and `driftplan.planning.roadmap.fused_edges`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from driftplan.arrays import Floats, Ints
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.planning.roadmap.edge_steps import NO_SITE

SIZE = 9  # of an error state

Score = tuple[Any, ...]  # what dominance looks at in one scenario


class Effects(Protocol):
    """What driving some edges does."""

    @property
    def edge(self) -> Ints:
        """Which edges, sorted, (m,)."""

    def driven(self, some: slice, begun: Floats) -> tuple[Floats, Floats]:
        """The states (k, 9, s) after the edges ``edge[some]``, and the greatest E|e|² on the way, m², (k, s).

        ``begun`` are the states where they begin: (9, s) for all of them, or (k, 9, s).
        """


class Dominance(Protocol):
    """Which label makes which superfluous."""

    def scores(self, states: Floats) -> list[list[Score]]:
        """What it looks at in every scenario of states (n, 9, s)."""

    def __call__(self, better: Sequence[Score], worse: Sequence[Score], turn_rad: float) -> bool:
        """Whether a label that first turns by an angle drifts no more than another, whatever follows."""


class EdgeErrors(Protocol):
    """The errors of a robot with one estimator on the edges of one graph."""

    def at_start(self, initial: Fix | None) -> Floats:
        """The state (9,) of a robot that knows where it is, exactly or as a fix says."""

    def read(self, state: Floats, site: int, place: complex) -> Floats:
        """The state (9,) after reading a beacon at a place."""

    def square(self, states: Floats) -> Floats:
        """E|e|², m², of states (..., 9, s)."""

    def turns(self, turn_rad: Floats, arriving: complex, noise: OdometryNoise) -> Floats:
        """What turns on the spot (k,) from a direction do, for `turned`."""

    def turned(self, state: Floats, turns: Floats) -> Floats:
        """States (k, 9, s) after each turn from states (9, s)."""

    def effects(self, edges: Ints, dead: int = NO_SITE) -> Effects:
        """Of edges, with one beacon dead."""

    def dominance(self, max_gap_m: float, slack_sq: float, turn_rates: tuple[float, float]) -> Dominance:
        """The rule for labels.

        Parameters
        ----------
        max_gap_m : no label gets farther than this without a reading, metres
        slack_sq : by what share of E|e|² a label may be worse and still dominate, m²
        turn_rates : heading (rad²) and position variance (m²) per radian turned, at most
        """
