"""Layout: beacons, what they cost, what is proven about them, and how each of them matters."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from driftplan.beacons.beacon import Beacon
from driftplan.files import write_files
from driftplan.layouts.placement.covering import Outcome
from driftplan.layouts.placement.failures import worst_without
from driftplan.layouts.scenario import Scenario
from driftplan.model.drift import Drift
from driftplan.page.document import page
from driftplan.page.scene import scene_of
from driftplan.tables import Tabular, decimals

_MAX_HTML_ROWS = 60


class Importance(NamedTuple):
    """What one beacon does."""

    beacon: Beacon
    routes: tuple[int, ...]  # that come within its range
    worst_single_failure: float  # greatest drift on any of them without it, metres (nan if there are none)
    worst_route: int  # where that is; -1 if there are none


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout(Tabular):
    """Result of `driftplan.layouts.place.place_beacons`.

    Attributes
    ----------
    beacons : those to be installed, in the order of the sites
    existing : those that were there
    cost : of `beacons`
    lower_bound : no layout that keeps the limit costs less
    proven : whether the layout is proven to be the best: for a limit, `cost` equals `lower_bound`; for a budget, the
        worst drift is within the tolerance of `drift_bound`
    status : Outcome
    max_drift : tuple of float, metres
        The limit of every route.
    drift_bound : for a budget: no layout within it has a smaller worst drift, metres. For a limit: 0.
    drifts : one per route, all beacons alive
    seconds : float
    scenario : what it is for
    """

    beacons: tuple[Beacon, ...]
    existing: tuple[Beacon, ...]
    cost: float
    lower_bound: float
    proven: bool
    status: Outcome
    max_drift: tuple[float, ...]
    drift_bound: float
    drifts: tuple[Drift, ...]
    seconds: float
    scenario: Scenario

    def __repr__(self) -> str:
        """What a person would want to know, not pages of moments."""
        return (
            f"Layout({len(self.beacons)} beacons of cost {self.cost:g}, at least {self.lower_bound:g}, "
            f"{'proven' if self.proven else 'not proven'}, {len(self.drifts)} routes, "
            f"worst drift {self.worst_drift:.4g} m)"
        )

    __str__ = __repr__

    def to_dicts(self) -> list[dict[str, Any]]:
        """One row per beacon, old and new, for JSON."""
        return [
            {
                "id": beacon.id,
                "kind": beacon.kind.name,
                "x_m": beacon.x,
                "y_m": beacon.y,
                "new": beacon in self.beacons,
                "routes": routes,
                "worst_single_failure_m": worst,
                "worst_route": worst_route,
            }
            for beacon, routes, worst, worst_route in self.importance
        ]

    def columns(self) -> dict[str, list[str]]:
        """What people read in a notebook: headings and cells."""
        shown = (*self.existing, *self.beacons)[:_MAX_HTML_ROWS]
        return {
            "id": [b.id for b in shown],
            "kind": [b.kind.name if b in self.beacons else f"{b.kind.name} (existing)" for b in shown],
            "x m": decimals([b.x for b in shown], 2),
            "y m": decimals([b.y for b in shown], 2),
        }

    def words(self) -> str:
        """What is said above it."""
        left_out = len(self.existing) + len(self.beacons) - _MAX_HTML_ROWS
        return f"{self!r}{f'; {left_out} beacons not shown' if left_out > 0 else ''}"

    @property
    def gap(self) -> float:
        """How much dearer than `lower_bound`, as a share of the cost."""
        return 0.0 if self.cost <= self.lower_bound else (self.cost - self.lower_bound) / self.cost

    @cached_property
    def worst_drifts(self) -> tuple[float, ...]:
        """Greatest drift on every route, all beacons alive, metres (rms, or the radius at the limit's confidence)."""
        return tuple(self.scenario.worst(drift) for drift in self.drifts)

    @property
    def worst_drift(self) -> float:
        """Greatest drift on any route, all beacons alive, metres."""
        return max(self.worst_drifts)

    @cached_property
    def worst_drift_if_fused(self) -> float:
        """Greatest drift on any route of a robot that fuses the readings of these beacons, metres."""
        scenario, everyone = replace(self.scenario, estimator="filter"), (*self.existing, *self.beacons)
        return max(scenario.worst(scenario.drift(r, everyone)) for r in range(len(self.drifts)))

    @property
    def note(self) -> str:
        """In a sentence, what a robot that fuses its readings would have, or where its filter stops being linear; empty
        where there is nothing to say, and with a confidence."""
        if self.scenario.confidence is not None:
            return ""
        if self.scenario.estimator == "reset":
            return (
                f"With the same beacons a robot that fuses its readings would drift at most "
                f'{self.worst_drift_if_fused:.3g} m; with estimator="filter" fewer may do.'
            )
        beyond = [r for r, drift in enumerate(self.drifts) if len(drift.beyond_linear)]
        if not beyond:
            return ""
        return (
            f"On {len(beyond)} of {len(self.drifts)} routes, the first of them route {beyond[0]}, the heading is less "
            "certain between readings than a filter can be trusted with."
        )

    def to_html(self, path: str | os.PathLike[str]) -> None:
        """Write a page, one file, on which the layout can be looked at and changed, with what the drift would be then.

        It needs a browser and nothing else, and asks nothing of any network.
        """
        scenario, limits = self.scenario, self.max_drift if self.scenario.confidence is None else None
        notes = [f"{self.status.value} {self.note}"]
        if scenario.confidence is not None:
            notes.append(f"The limit was on the {100 * scenario.confidence:g} % radius; this page computes the rms.")
        if scenario.redundancy > 1:
            notes.append(f"It holds with any {scenario.redundancy - 1} of the beacons dead: kill some to see.")
        scene = scene_of(
            scenario.world,
            scenario.routes,
            scenario.noise,
            beacons=self.beacons,
            existing=self.existing,
            limits=limits,
            estimator=scenario.estimator,
            start_fix=scenario.start_fix,
            title="Beacon layout",
            notes=notes,
        )
        write_files({Path(path): page(scene)})

    @cached_property
    def importance(self) -> tuple[Importance, ...]:
        """For every beacon, old and new: the routes that come within its range and the worst drift without it."""
        everyone = (*self.existing, *self.beacons)
        in_range = [set(self.scenario.beacons_in_range(r, everyone)) for r in range(len(self.drifts))]
        cases = [(k, r) for k, beacon in enumerate(everyone) for r, here in enumerate(in_range) if beacon in here]
        without: list[dict[int, float]] = [{} for _ in everyone]
        for (k, r), worst in zip(
            cases, worst_without(self.scenario, everyone, cases, min(self.max_drift)), strict=True
        ):
            without[k][r] = worst
        found = []
        for beacon, drifts in zip(everyone, without, strict=True):
            worst_route = max(drifts, key=lambda r: drifts[r], default=-1)
            found.append(Importance(beacon, tuple(drifts), drifts.get(worst_route, float("nan")), worst_route))
        return tuple(found)
