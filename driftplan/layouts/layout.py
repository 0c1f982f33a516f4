"""Layout: beacons, what they cost, what is proven about them, how each of them matters; as files, and side by side."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import nan
from pathlib import Path
from typing import Any, NamedTuple

from driftplan.beacons.beacon import Beacon
from driftplan.files import write_files
from driftplan.layouts.placement.drives import worst_drifts
from driftplan.layouts.scenario import Scenario
from driftplan.model.drift import Drift
from driftplan.page.scene import page, scene_of
from driftplan.planning.status import Status
from driftplan.tables import Rows, Tabular, decimals, digits, yes_no

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
    max_drift : the limit of every route, metres
    drift_bound : for a budget: no layout within it has a smaller worst drift, metres. For a limit: 0.
    drifts : one per route, all beacons alive
    scenario : what it is for

    >>> from driftplan import BeaconKind, OdometryNoise, Sites, place_beacons
    >>> noise, sites = OdometryNoise(distance_var_per_m=0.01), Sites(BeaconKind.rfid(1.0, 0.1), [(5, 0), (12, 0)])
    >>> layout = place_beacons(None, [(0, 0), (20, 0)], noise, 0.35, sites)
    >>> len(layout.beacons), layout.proven, layout.worst_drift < 0.35
    (1, True, True)
    """

    beacons: tuple[Beacon, ...]
    existing: tuple[Beacon, ...]
    cost: float
    lower_bound: float
    proven: bool
    status: Status
    max_drift: tuple[float, ...]
    drift_bound: float
    drifts: tuple[Drift, ...]
    seconds: float
    scenario: Scenario

    def __repr__(self) -> str:
        return (
            f"Layout({len(self.beacons)} beacons of cost {self.cost:g}, at least {self.lower_bound:g}, "
            f"{'proven' if self.proven else 'not proven'}, {len(self.drifts)} routes, "
            f"worst drift {self.worst_drift:.4g} m)"
        )

    __str__ = __repr__

    def to_dicts(self) -> list[dict[str, Any]]:
        """The rows of `installer_table`, in the order of the beacons, old ones first."""
        from driftplan.layouts.layout_files import installer_rows

        return [row._asdict() for row in installer_rows(self)]

    def columns(self) -> dict[str, list[str]]:
        shown = self.everyone[:_MAX_HTML_ROWS]
        return {
            "id": [b.id for b in shown],
            "kind": [b.kind.name if b in self.beacons else f"{b.kind.name} (existing)" for b in shown],
            "x m": decimals([b.x for b in shown], 2),
            "y m": decimals([b.y for b in shown], 2),
        }

    def words(self) -> str:
        left_out = len(self.everyone) - _MAX_HTML_ROWS
        return f"{self!r}{f'; {left_out} beacons not shown' if left_out > 0 else ''}"

    @property
    def everyone(self) -> tuple[Beacon, ...]:
        """All beacons, old ones first."""
        return (*self.existing, *self.beacons)

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
        scenario, everyone = replace(self.scenario, estimator="filter"), self.everyone
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
            f"On {len(beyond)} of {len(self.drifts)} routes, the first of them route {beyond[0]}, the heading between "
            "readings, or the direction of a range or bearing, is less certain than a filter can be trusted with."
        )

    def to_html(self, path: str | os.PathLike[str]) -> None:
        """Write a page, one file, on which the layout can be looked at and changed, with what the drift would be then.

        It needs a browser and nothing else, and asks nothing of any network.
        """
        scenario, notes = self.scenario, [f"{self.status.value} {self.note}"]
        if scenario.confidence is not None:
            notes.append(f"The limit was on the {100 * scenario.confidence:g} % radius; this page computes the rms.")
        if scenario.redundancy > 1:
            notes.append(f"It holds with any {scenario.redundancy - 1} of the beacons dead: kill some to see.")
        limits = self.max_drift if scenario.confidence is None else None
        placed: dict[str, Any] = {"beacons": self.beacons, "existing": self.existing, "limits": limits, "notes": notes}
        robot: dict[str, Any] = {"estimator": scenario.estimator, "start_fix": scenario.start_fix}
        scene = scene_of(scenario.world, scenario.routes, scenario.noise, title="Beacon layout", **placed, **robot)
        write_files({Path(path): page(scene)})

    @cached_property
    def importance(self) -> tuple[Importance, ...]:
        """For every beacon, old and new: the routes that come within its range and the worst drift without it."""
        everyone = self.everyone
        cases = [(r, (k,)) for r in range(len(self.drifts)) for k in self.scenario.beacons_in_range(r, everyone)]
        without: list[dict[int, float]] = [{} for _ in everyone]
        for (r, (k,)), worst in zip(cases, worst_drifts(self.scenario, everyone, cases).tolist(), strict=True):
            without[k][r] = worst
        worst_route = [max(drifts, key=drifts.__getitem__, default=-1) for drifts in without]
        return tuple(
            Importance(beacon, tuple(drifts), drifts.get(r, nan), r)
            for beacon, drifts, r in zip(everyone, without, worst_route, strict=True)
        )


@dataclass(frozen=True, kw_only=True)
class LayoutComparison(Rows):
    """Layouts side by side, a row each: name, beacons (new ones), existing, cost, lower_bound, proven, routes, route_m
    (of all together), max_drift_m (the strictest limit), worst_drift_m, and worst_single_failure_m, the greatest drift
    with one beacon dead (nan without beacons). Printing it prints a table."""

    def columns(self) -> dict[str, Iterable[object]]:
        rows = self.rows
        worst, failure = digits(*([row[key] for row in rows] for key in ("worst_drift_m", "worst_single_failure_m")))
        return {
            "layout": [row["name"] for row in rows],
            "beacons": [row["beacons"] for row in rows],
            "cost": [f"{row['cost']:g}" for row in rows],
            "at least": [f"{row['lower_bound']:g}" for row in rows],
            "proven": yes_no(row["proven"] for row in rows),
            "routes m": decimals([row["route_m"] for row in rows], 1),
            "limit m": [f"{row['max_drift_m']:.4g}" for row in rows],
            "worst drift m": worst,
            "with one dead m": failure,
        }


def compare_layouts(layouts: Mapping[str, Layout]) -> LayoutComparison:
    """What layouts, by name, cost and what they keep, side by side; their routes and limits need not be the same.

    >>> from driftplan import BeaconKind, OdometryNoise, Sites, place_beacons
    >>> noise = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
    >>> tag = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01)
    >>> routes, sites = {"short": [(0, 0), (30, 0)], "long": [(0, 0), (60, 0)]}, Sites(tag, spacing_m=2.0)
    >>> layouts = {name: place_beacons(None, route, noise, 0.8, sites) for name, route in routes.items()}
    >>> print(compare_layouts(layouts))
    layout  beacons  cost  at least  proven  routes m  limit m  worst drift m  with one dead m
    short         1     1         1  yes         30.0      0.8          0.794            1.050
    long          2     2         2  yes         60.0      0.8          0.794            2.448
    """
    if not isinstance(layouts, Mapping) or not layouts or not all(isinstance(x, Layout) for x in layouts.values()):
        raise ValueError(f"expected layouts by name, as {{'narrow': place_beacons(...)}}, got {layouts!r}")
    return LayoutComparison(rows=tuple(_row(name, layout) for name, layout in layouts.items()))


def _row(name: str, layout: Layout) -> dict[str, Any]:
    return {
        "name": name,
        "beacons": len(layout.beacons),
        "existing": len(layout.existing),
        **{key: getattr(layout, key) for key in ("cost", "lower_bound", "proven")},
        "routes": len(layout.drifts),
        "route_m": sum(float(drift.length) for drift in layout.drifts),
        "max_drift_m": min(layout.max_drift),
        "worst_drift_m": layout.worst_drift,
        "worst_single_failure_m": max((x.worst_single_failure for x in layout.importance if x.routes), default=nan),
    }
