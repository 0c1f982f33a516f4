"""``driftplan selftest``: whether an installed copy computes what it should, on this machine, with these libraries."""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Iterator
from importlib.metadata import version
from itertools import combinations
from math import exp, nan
from typing import Any, NamedTuple

from driftplan.report.commands.answer import Answer, talk
from driftplan.report.commands.option import Command
from driftplan.tables import counted, table

_DRIVES = 10_000
_SIGMAS = 5.0  # of a simulated mean: one healthy copy in a million may fail
_PATH = [(0, 0), (6, 0), (6, 4), (1, 4)]


class Check(NamedTuple):
    """A number, and between what it should be by other means."""

    what: str
    by: str
    got: float
    least: float
    most: float

    @property
    def holds(self) -> bool:
        return self.least <= self.got <= self.most


def _close(what: str, by: str, got: float, expected: float) -> Check:
    return Check(what, by, got, expected - 1e-9, expected + 1e-9)


def _straight() -> Iterator[Check]:
    from driftplan import OdometryNoise, predict_drift

    q, length = 0.02, 10.0  # the heading is a random walk of variance q s: E exp(jh) = exp(-q s / 2)
    mean = 2 / q * (1 - exp(-q * length / 2))
    square = 8 / q**2 * (q * length / 2 - 1 + exp(-q * length / 2)) - 2 * length * mean + length**2
    noise = OdometryNoise(heading_var_per_m=q)
    end = predict_drift([(0, 0), (length, 0)], noise).end
    yield _close("mean error of a straight run, m", "its integral", float(end.bias[0]), mean - length)
    yield _close("rms of a straight run, m", "its integral", float(end.rms), square**0.5)
    steps = predict_drift([(length * k / 1000, 0) for k in range(1001)], noise).end
    yield _close("rms of 1000 steps, m", "one run", float(steps.rms), float(end.rms))


def _simulated() -> Iterator[Check]:
    from driftplan import Fix, OdometryNoise, predict_drift, simulate_drift

    rates: dict[str, Any] = {"heading_var_per_m": 1e-3, "heading_var_per_rad": 1e-3, "distance_var_per_m": 2e-3}
    noise = OdometryNoise(**rates, distance_scale_error=0.01)
    fix = Fix.full(8.0, position_std_m=0.1, heading_std=0.02)
    for robot, fixes, linear in (("reset", (), 0.0), ("reset", (fix,), 0.0), ("filter", (fix,), 0.03)):
        asked: dict[str, Any] = {"fixes": fixes, "estimator": robot}
        got = float(predict_drift(_PATH, noise, **asked).end.rms) ** 2
        squares = (simulate_drift(_PATH, noise, runs=_DRIVES, rng=1, substep_m=0.1, **asked)[:, -1] ** 2).sum(axis=-1)
        mean = float(squares.mean())
        off = _SIGMAS * float(squares.std()) / _DRIVES**0.5 + linear * mean
        what = "mean square error" + (f" past a fix, {robot}" if fixes else "") + ", m²"
        yield Check(what, f"{_DRIVES} simulated drives", got, mean - off, mean + off)


def _planned() -> Iterator[Check]:
    import shapely

    from driftplan import OdometryNoise, bundled_map, load_world, plan_route, predict_drift

    noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    world = load_world(bundled_map("office"), robot_radius=0.3)
    route = plan_route(world, (36.0, 12.0), (6.0, 5.0), noise, iterations=2)
    shortest = plan_route(world, (36.0, 12.0), (6.0, 5.0), noise, minimise="length", iterations=2)
    outside = shapely.LineString(route.path).difference(world.free.buffer(1e-6)).length
    yield _close("length of the route in walls, m", "shapely", outside, 0.0)
    yield _close("drift of the route, m", "its path", route.rms, float(predict_drift(route.path, noise).end.rms))
    yield Check("its drift, m", "its bound, the shortest route", route.rms, route.bound, shortest.rms + 1e-9)


def _placed() -> Iterator[Check]:
    from driftplan import Beacon, BeaconKind, OdometryNoise, Sites, drift_with_beacons, place_beacons

    noise, limit = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.1, after_m=10.0), 0.35
    path, tag = [(0, 0), (12, 0), (12, 8)], BeaconKind.rfid(range_m=0.7, position_std_m=0.1)
    sites = [Beacon(tag, x, 0.5) for x in range(2, 12, 2)] + [Beacon(tag, 12.5, y) for y in range(1, 8, 2)]

    def holds(some: tuple[Beacon, ...]) -> bool:
        return bool(drift_with_beacons(path, noise, some).profile(0.05).rms.max() <= limit)

    least = next((k for k in range(len(sites) + 1) if any(map(holds, combinations(sites, k)))), len(sites) + 1)
    layout = place_beacons(None, [path], noise, limit, Sites(points=sites), time_limit=60.0)
    yield Check("fewest beacons", "all sets of sites", len(layout.beacons), least, least)
    yield Check("fewest beacons, proven", "all sets of sites", layout.lower_bound, least, least)
    yield Check("worst drift among them, m", "the limit", layout.worst_drift, 0.0, limit)


def _fitted() -> Iterator[Check]:
    from driftplan import OdometryNoise, fit_noise, simulate_log

    noise = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3, distance_scale_error=0.02)
    odometry, truth = simulate_log(20 * [(0, 0), (5, 0), (5, 5), (0, 5)], noise, rng=1)
    intervals = fit_noise(odometry, truth, confidence=0.999, resamples=200).intervals
    for name in ("heading_var_per_m", "distance_var_per_m", "distance_scale_error"):
        yield Check(f"simulated {name}", "its fit", getattr(noise, name), *intervals[name])


_PARTS = {"model": _straight, "simulation": _simulated, "plan": _planned, "placement": _placed, "fit": _fitted}


def run(args: argparse.Namespace) -> Answer:
    """Everything that is compared, part by part: what stops one says so and fails."""
    began = time.monotonic()
    rows: list[tuple[str, bool, Check]] = []
    for part, checks in _PARTS.items():
        talk(f"comparing: {part}")
        try:
            rows += [(part, check.holds, check) for check in checks()]
        except Exception as err:  # whatever is wrong with this copy
            rows.append((part, False, Check(f"{type(err).__name__}: {err}", "", nan, nan, nan)))
    failed, took = sum(not holds for _, holds, _ in rows), time.monotonic() - began
    libraries = {name: version(name) for name in ("driftplan", "numpy", "scipy", "shapely", "ompl", "matplotlib")}
    libraries |= {"python": platform.python_version(), "platform": platform.platform()}

    def text() -> str:
        columns: dict[str, list[str]] = {"part": [part for part, _, _ in rows]}
        columns |= {"compared": [check.what for *_, check in rows], "with": [check.by for *_, check in rows]}
        for name, title in (("got", "got"), ("least", "at least"), ("most", "at most")):
            columns[title] = [f"{getattr(check, name):.6g}" for *_, check in rows]
        shown = table({**columns, "": ["ok" if holds else "FAILED" for _, holds, _ in rows]})
        verdict = f"{counted(failed, 'comparison')} FAILED" if failed else f"all {len(rows)} comparisons hold"
        return f"{shown}\n\n{', '.join(f'{k} {v}' for k, v in libraries.items())}\n{verdict} ({took:.1f} s)"

    compared = [{"part": part, "holds": holds, **check._asdict()} for part, holds, check in rows]
    payload = {"passed": not failed, "checks": compared, "versions": libraries}
    return Answer(payload=lambda: payload, text=text, failed=failed > 0)


COMMAND = Command(
    summary="whether this installed copy computes what it should",
    description="Compare the model with integrals and simulated drives, a route with shapely and its bound, a layout "
    "with all sets of sites, a fit with what was simulated; print what was compared. Takes some seconds. Exit code 1 "
    "if something differs: then please report all that is printed.",
    run=run,
    examples=("", "--json"),
)
