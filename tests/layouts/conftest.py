"""Small placement instances, and what brute force says about each of their layouts."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np
import pytest

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.readings import beacon_passes, drift_with_beacons
from driftplan.model.noise import OdometryNoise
from driftplan.model.worst import worst_radius, worst_rms

NOISE = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3, heading_var_per_rad=5e-4)
TAG = BeaconKind.rfid(2.0, 0.1)
PERFECT = BeaconKind.landmark(2.0, 0.0, 0.0, line_of_sight=False)
FINE = BeaconKind.landmark(2.0, 0.02, 0.005, line_of_sight=False)
COARSE = BeaconKind.landmark(2.0, 0.1, 0.05, line_of_sight=False)
COMPASS = BeaconKind.heading(2.0, 0.02)
SHY_TAG = BeaconKind.rfid(2.0, 0.1, detection_probability=0.8)
SHY_SIGN = BeaconKind.landmark(2.0, 0.1, 0.05, detection_probability=0.7, line_of_sight=False)

RANGES = BeaconKind.range_only(4.0, 0.1, std_per_m=0.02)
SHY_RANGES = BeaconKind.range_only(3.0, 0.05, detection_probability=0.8)
LIGHT = BeaconKind.bearing(3.0, 0.03, line_of_sight=False, sensor_view_deg=200.0)
SHELF_TAG = replace(TAG, view_angle_deg=120.0)

FUSED_KINDS = {
    "ranges": (RANGES, SHY_RANGES),
    "lights": (LIGHT, TAG),
    "seen from in front": (SHELF_TAG, replace(FINE, view_angle_deg=180.0), RANGES),
}
KINDS = {
    "tags": (TAG,),
    "perfect": (PERFECT,),
    "coarse": (COARSE,),
    "two full": (FINE, COARSE),
    "mixed": (TAG, FINE, COARSE),
    "with compass": (TAG, COARSE, COMPASS),
    "unsure": (SHY_TAG, SHY_SIGN),
    "everything": (TAG, FINE, COARSE, COMPASS, SHY_TAG, SHY_SIGN),
}


@dataclass
class Instance:
    """Routes, sites and a limit; the drift of every subset of sites, route by route, by `predict_drift`."""

    paths: list
    sites: list
    cost: np.ndarray
    redundancy: int
    doubles_back: bool = False
    limit_draw: float = 0.0  # how far up the ladder of drifts the limit lies, as a share
    noise: OdometryNoise = NOISE
    fixed: int = 0  # bits of the sites that exist
    groups: tuple = ()  # of (members, at_least, at_most)
    confidence: float | None = None
    estimator: str = "reset"
    _worst: dict = field(default_factory=dict)

    @cached_property
    def limit(self) -> float:
        """In a gap between the drifts of two subsets: a limit all but equal to one would test rounding, no search."""
        drifts = np.unique([self.worst(s) for s in range(2 ** len(self.sites))])
        gaps = np.flatnonzero(np.diff(drifts) > 2e-3 * drifts[1:])
        if not len(gaps):
            return float(drifts[-1]) * 1.1
        k = gaps[min(int(self.limit_draw * len(gaps)), len(gaps) - 1)]
        return float(drifts[k] + drifts[k + 1]) / 2

    @cached_property
    def meets(self) -> list[int]:
        """For every route the bits of the sites it meets."""
        return [sum(1 << i for i, s in enumerate(self.sites) if len(beacon_passes(p, s))) for p in self.paths]

    def worst(self, subset: int) -> float:
        """Greatest drift on any route with exactly these sites."""
        return max(self._worst_on(r, subset) for r in range(len(self.paths)))

    def _worst_on(self, r, subset):
        key = r, subset & self.meets[r]
        if key not in self._worst:
            drift = drift_with_beacons(self.paths[r], self.noise, self.named(key[1]), estimator=self.estimator)
            self._worst[key] = worst_rms(drift) if self.confidence is None else worst_radius(drift, self.confidence)
        return self._worst[key]

    def members(self, subset):
        return [i for i in range(len(self.sites)) if subset >> i & 1]

    def named(self, subset):
        return [self.sites[i] for i in self.members(subset)]

    def allowed(self, subset: int) -> bool:
        """Whether the groups are satisfied."""
        inside = ((sum(subset >> i & 1 for i in some), least, most) for some, least, most in self.groups)
        return all(least <= count <= most for count, least, most in inside)

    def acceptable(self, subset: int) -> bool:
        """Whether the limit holds with any redundancy - 1 sites dead."""
        return all(
            self.worst(subset - sum(1 << i for i in dead)) <= self.limit
            for size in range(self.redundancy)
            for dead in combinations(self.members(subset), size)
        )

    def cost_of(self, subset: int) -> float:
        return float(sum(self.cost[i] for i in self.members(subset & ~self.fixed)))

    def cheapest(self, allowed=lambda subset: True) -> float:
        """Least cost of all acceptable layouts that hold the fixed sites; inf if there is none."""
        return min(
            (
                self.cost_of(s)
                for s in range(2 ** len(self.sites))
                if s & self.fixed == self.fixed and self.allowed(s) and allowed(s) and self.acceptable(s)
            ),
            default=np.inf,
        )


def random_instance(seed: int, kinds, *, sites=(4, 7), existing=False, groups=False) -> Instance:
    """Random polylines, some driven there and back, with sites near them."""
    rng = np.random.default_rng(seed)
    paths, back = [], False
    for _ in range(int(rng.integers(1, 4))):
        path = np.cumsum(
            np.concatenate([rng.uniform(0, 20, (1, 2)), rng.uniform(-10, 10, (rng.integers(1, 5), 2))]), axis=0
        )
        there_and_back = rng.random() < 0.4
        back = back or there_and_back
        paths.append(np.concatenate([path, path[-2::-1]]) if there_and_back else path)
    beacons = []
    for _ in range(int(rng.integers(sites[0], sites[1] + 1))):
        path = paths[rng.integers(len(paths))]
        k = rng.integers(len(path) - 1)
        xy = path[k] + rng.random() * (path[k + 1] - path[k]) + rng.normal(0, 0.5, 2)
        kind = kinds[rng.integers(len(kinds))]
        facing_deg = float(rng.uniform(0, 360)) if kind.view_angle_deg < 360 else None
        beacons.append(Beacon(kind, *xy, id=f"b{len(beacons)}", facing_deg=facing_deg))
    n = len(beacons)
    cost = rng.integers(1, 4, n).astype(float) if rng.random() < 0.5 else np.ones(n)
    redundancy = int(rng.integers(1, 4)) if rng.random() < 0.4 else 1
    instance = Instance(paths, beacons, cost, redundancy, back, limit_draw=float(rng.exponential(0.25)))
    if existing:
        instance.fixed = 1 << int(rng.integers(n))
    if groups:
        new = [i for i in range(n) if not instance.fixed >> i & 1]
        crowd, few = (rng.choice(new, size=int(rng.integers(1, len(new) + 1)), replace=False) for _ in range(2))
        at_most = int(rng.integers(1, len(crowd) + 1))
        instance.groups = ((tuple(crowd.tolist()), 0, at_most), (tuple(few.tolist()), 1, n))
    return instance


def two_hundred():
    """The names of kinds and the seeds of 200 instances, with all that placement allows for (a test counts them)."""
    return [(name, seed) for name in KINDS for seed in range(300, 325)]


def instance_of(name, seed, *, sites=(4, 7)) -> Instance:
    """One of the 200, or one more like them."""
    return random_instance(
        seed, {**KINDS, **FUSED_KINDS}[name], sites=sites, existing=seed % 3 == 0, groups=seed % 4 == 0
    )


@pytest.fixture
def make_instance():
    return random_instance


@pytest.fixture
def kinds_named():
    return KINDS


@pytest.fixture
def one_of_them():
    return instance_of


def pytest_generate_tests(metafunc):
    if "of_two_hundred" in metafunc.fixturenames:
        metafunc.parametrize("of_two_hundred", two_hundred(), ids=lambda pair: f"{pair[0]}-{pair[1]}")
