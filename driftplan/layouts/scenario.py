"""What a layout is for: routes, the noise on them, and the limit that their drift has to keep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from driftplan.arrays import Floats, choice
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import BeaconColumns, drift_with_beacons, readings_on, waypoints_of
from driftplan.model.drift import Drift
from driftplan.model.noise import OdometryNoise, check_continuous
from driftplan.model.point_drift import PointDrift
from driftplan.model.readings import Estimator, Fix, Readings
from driftplan.model.worst import worst_radius, worst_rms
from driftplan.planning.request import DriftLimit
from driftplan.world.world import World
from driftplan.world.zones import noises_on


@dataclass(frozen=True, eq=False)
class Scenario:
    """Routes and how drift on them is scored; made by `Scenario.of`."""

    world: World | None
    routes: tuple[Floats, ...]  # (n, 2) each, metres
    noise: OdometryNoise
    start_fix: Fix | None = None  # uncertainty at the start of every route
    confidence: float | None = None  # of the `DriftLimit`
    redundancy: int = 1  # likewise
    estimator: Estimator = "reset"  # what the robot does with a reading

    @classmethod
    def of(
        cls,
        world: World | None,
        routes: Any,
        noise: OdometryNoise,
        limit: DriftLimit,
        start_fix: Fix | None = None,
        estimator: Estimator = "reset",
    ) -> Scenario:
        """A scenario of one route or several, each (n, 2) or an object with a ``path``; all of it checked."""
        choice("estimator", estimator, Estimator)
        if limit.min_capture is not None:
            raise ValueError(f"expected no min_capture where routes are given: every reading counts, got {limit}")
        if estimator == "filter" and limit.confidence is not None:
            raise ValueError(
                f"expected confidence only for estimator='reset', got {limit.confidence:g}: with a filter limits are "
                "on the rms"
            )
        if start_fix is not None and not (isinstance(start_fix, Fix) and start_fix.s_m == 0):
            raise ValueError(f"expected start_fix to be a Fix at s_m=0, got {start_fix!r}")
        check_continuous(noises_on(world, noise))
        return cls(world, _routes_of(routes), noise, start_fix, limit.confidence, limit.redundancy, estimator)

    @property
    def drives_differ(self) -> bool:
        """Whether systematic errors differ from one drive to the next, on any floor."""
        return any(noise.varies_between_drives for noise in noises_on(self.world, self.noise))

    def drift(self, route: int, beacons: Sequence[Beacon]) -> Drift:
        """Drift along one route with the given beacons alive."""
        fixes = () if self.start_fix is None else (self.start_fix,)
        path, estimator = self.routes[route], self.estimator
        return drift_with_beacons(path, self.noise, beacons, self.world, fixes=fixes, estimator=estimator)

    def readings(self, beacons: Sequence[Beacon]) -> tuple[Readings, ...]:
        """What could be read of beacons on every route."""
        columns = BeaconColumns.of(beacons)
        return tuple(readings_on(path, columns, self.world) for path in self.routes)

    def score(self, drift: PointDrift) -> Floats:
        """The score that limits are about: rms, or the radius at the confidence."""
        return drift.rms if self.confidence is None else drift.radius(self.confidence)

    def worst(self, drift: Drift) -> float:
        """Greatest score anywhere along a route, metres: `worst_rms`, or `worst_radius` at the confidence."""
        return worst_rms(drift) if self.confidence is None else worst_radius(drift, self.confidence)

    def beacons_in_range(self, route: int, beacons: Sequence[Beacon]) -> list[int]:
        """Positions of the beacons that a route comes within range of, and in sight where they must be seen."""
        return beacons_in_range(self.world, self.routes[route], beacons)


def beacons_in_range(world: World | None, path: Floats, beacons: Sequence[Beacon]) -> list[int]:
    """Positions of the beacons that a path comes within range of, and in sight where they must be seen."""
    found: list[int] = np.unique(BeaconColumns.of(beacons).passes(path, world).beacon).tolist()
    return found


def _routes_of(routes: Any) -> tuple[Floats, ...]:
    if hasattr(routes, "path"):
        return (waypoints_of(routes),)
    try:
        array = np.asarray(routes)
    except (TypeError, ValueError):
        array = np.zeros(0)  # several of different lengths
    if array.ndim == 2 and array.dtype.kind in "iuf":
        return (waypoints_of(array),)
    if array.ndim == 0 or isinstance(routes, (str, bytes)) or not hasattr(routes, "__len__") or not len(routes):
        raise ValueError(f"expected routes to be one path (n, 2) or a sequence of them, got {routes!r}")
    found = []
    for k, route in enumerate(routes):
        try:
            found.append(waypoints_of(route))
        except ValueError as err:
            raise ValueError(f"route {k}: {err}") from None
    return tuple(found)
