"""Small placement instances, and what brute force says about each of their layouts."""

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import pytest

from driftplan.beacons.beacon import Beacon, BeaconKind, drift_with_beacons, passes
from driftplan.model.noise import OdometryNoise

NOISE = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3, heading_var_per_rad=5e-4)
TAG = BeaconKind.rfid(2.0, 0.1)
PERFECT = BeaconKind.landmark(2.0, 0.0, 0.0, line_of_sight=False)
FINE = BeaconKind.landmark(2.0, 0.02, 0.005, line_of_sight=False)
COARSE = BeaconKind.landmark(2.0, 0.1, 0.05, line_of_sight=False)
COMPASS = BeaconKind.heading(2.0, 0.02)
SHY_TAG = BeaconKind.rfid(2.0, 0.1, detection_probability=0.8)
SHY_SIGN = BeaconKind.landmark(2.0, 0.1, 0.05, detection_probability=0.7, line_of_sight=False)

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
    limit: float = 0.0
    noise: OdometryNoise = NOISE
    fixed: int = 0  # bits of the sites that exist
    _worst: dict = field(default_factory=dict)

    def worst(self, subset: int) -> float:
        """Greatest rms on any route with exactly these sites."""
        return max(self._worst_on(r, subset) for r in range(len(self.paths)))

    def _worst_on(self, r, subset):
        key = r, subset & self._meets[r]
        if key not in self._worst:
            alive = [site for i, site in enumerate(self.sites) if key[1] >> i & 1]
            # Between borders E|e|² is convex but for terms of third order: 200 points more than do.
            self._worst[key] = float(drift_with_beacons(self.paths[r], self.noise, alive).profile().rms.max())
        return self._worst[key]

    def __post_init__(self):
        self._meets = [sum(1 << i for i, s in enumerate(self.sites) if len(passes(p, s))) for p in self.paths]

    def members(self, subset):
        return [i for i in range(len(self.sites)) if subset >> i & 1]

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
                if s & self.fixed == self.fixed and allowed(s) and self.acceptable(s)
            ),
            default=np.inf,
        )


def random_instance(seed: int, kinds, *, sites=(4, 7), existing=False) -> Instance:
    """Random polylines, some driven there and back, with sites near them; the limit lies in a gap between drifts."""
    rng = np.random.default_rng(seed)
    paths = []
    for _ in range(int(rng.integers(1, 4))):
        path = np.cumsum(
            np.concatenate([rng.uniform(0, 20, (1, 2)), rng.uniform(-10, 10, (rng.integers(1, 5), 2))]), axis=0
        )
        paths.append(np.concatenate([path, path[-2::-1]]) if rng.random() < 0.4 else path)
    beacons = []
    for _ in range(int(rng.integers(sites[0], sites[1] + 1))):
        path = paths[rng.integers(len(paths))]
        k = rng.integers(len(path) - 1)
        xy = path[k] + rng.random() * (path[k + 1] - path[k]) + rng.normal(0, 0.5, 2)
        beacons.append(Beacon(kinds[rng.integers(len(kinds))], *xy, id=f"b{len(beacons)}"))
    cost = rng.integers(1, 4, len(beacons)).astype(float) if rng.random() < 0.5 else np.ones(len(beacons))
    redundancy = int(rng.integers(1, 4)) if rng.random() < 0.4 else 1
    instance = Instance(paths, beacons, cost, redundancy)
    if existing:
        instance.fixed = 1 << int(rng.integers(len(beacons)))
    drifts = np.unique([instance.worst(s) for s in range(2 ** len(beacons))])
    # A limit nearer than 0.1 % to the drift of some layout would test the sampling of `worst`, not the search.
    gaps = np.flatnonzero(np.diff(drifts) > 2e-3 * drifts[1:])
    if len(gaps):
        k = gaps[min(int(rng.exponential(0.25) * len(gaps)), len(gaps) - 1)]
        instance.limit = float(drifts[k] + drifts[k + 1]) / 2
    else:
        instance.limit = float(drifts[-1]) * 1.1
    return instance


@pytest.fixture
def make_instance():
    return random_instance


@pytest.fixture
def kinds_named():
    return KINDS
