"""Calls everything that is public with arguments of all sorts, and prints the calls that went wrong.

``python -m tests.fuzz.calls SEED COUNT [NAME ...]``. Arguments follow the signature: most are what it asks for, the
others anything. A call may give a value, or raise what is documented, in words of driftplan's own, within its seconds
of the processor and a gigabyte of memory.
"""

from __future__ import annotations

import inspect
import io
import os
import random
import re
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from reprlib import repr as short
from types import MappingProxyType
from typing import Any

import numpy as np
from ompl import base as ob

import driftplan as d
from tests.fuzz.files import Hang, limit_memory, limited

SECONDS = 3.0
NOISE = d.OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=1e-4)
WORLD = d.World.from_polygons([[(4, 4), (5, 4), (5, 5)]], bounds=(0, 0, 9, 9), robot_radius=0.1)
TAG = d.BeaconKind.rfid(1.5, 0.1)
BEACON = d.Beacon(TAG, 2.0, 1.0, "A1")
PATH = ((1.0, 1.0), (8.0, 1.0), (8.0, 8.0))
DRIFT = d.predict_drift(PATH, NOISE)
ROUTE = d.plan_route(WORLD, (1, 1), (8, 8), NOISE, iterations=1)
LAYOUT = d.place_beacons(WORLD, [PATH], NOISE, 0.2, d.Sites(TAG, spacing_m=1.0))
_TIMES = np.arange(200.0)
_TURNS = 0.1 * np.sin(_TIMES / 9).cumsum()
_STEPS = np.stack([np.cos(_TURNS), np.sin(_TURNS)], axis=-1).cumsum(axis=0)
TRUTH = d.Trajectory(_TIMES, _STEPS, _TURNS)
SPACE = ob.RealVectorStateSpace(2)
SPACE.setBounds(0, 9)
SI = ob.SpaceInformation(SPACE)
d.use_world(SI, WORLD)
NODES = '{"type": "FeatureCollection", "features": []}'
GRAPH = d.RouteGraph((0, 1), np.array([[1.0, 1.0], [8.0, 1.0]]), (2,), np.array([[0, 1]]), ({},), NODES)
GOOD = {  # arguments by their name, or by what they are annotated with
    "path": PATH, "paths": [PATH], "routes": [PATH], "start": (1, 1), "goal": (8, 8), "limit": 1.0, "sites": TAG,
    "kind": TAG, "trips": [((1, 1), (8, 8))], "truth": _STEPS, "truths": TRUTH, "estimate": _STEPS, "estimates": TRUTH,
    "si": SI, "name": "tag", "layouts": {"a": LAYOUT}, "time_limit": 0.1, "iterations": 1, "runs": 10, "rng": 0,
    "bounds": (0, 0, 9, 9), "times": _TIMES, "xy": _STEPS, "obstacles": WORLD.obstacles, "resamples": 100,
    "max_nodes": 50, "rounds": 1, "workers": 1, "estimator": "reset", "minimise": "rms", "confidence": 0.9,
    "waypoints": [(0, 0, 0), (1, 0, 1), (5, 5, 1)], "rotations": np.stack([np.eye(3)] * 3), "translations": np.eye(3),
    "points": PATH, "clockwise": [(0.1, 0.1)], "counterclockwise": [(0.1, -0.2)], "polygon": WORLD.obstacles,
    "objective": d.DriftObjective(SI, NOISE, (8, 8)), "World": WORLD, "OdometryNoise": NOISE, "Beacon": BEACON,
    "BeaconKind": TAG, "Drift": DRIFT, "Route": ROUTE, "Layout": LAYOUT, "RouteGraph": GRAPH,
    "Fix": d.Fix(s_m=3.0, position_cov=np.eye(2) * 0.01), "float": 1.0, "int": 1, "bool": True, "ArrayLike": PATH,
    "str | os.PathLike[str]": "a.yaml", "Sequence[Beacon]": [BEACON], "Sequence[Layout]": [LAYOUT],
    "Sequence[Any]": [], "Zone": (), "RotationNoise": d.RotationNoise.isotropic(1e-3),
}  # fmt: skip
ODD = (
    None, False, True, 0, 1, 2, -1, 3.5, 0.1, float("nan"), float("inf"), -float("inf"), 1e-320, 1e-308, 1e-50, 1e-9,
    1e13, 1e14, 1e200, 10**400, "x", "", "reset", "filter", "rms", b"x", (), [], {}, set(), [1], [None], (1, 2),
    [(0, 0)], [(0, 0), (1, "a")], [[1, 2], [3]], [(0, 0), (1e-308, 0)], [(0, 0), (1e13, 1e13)], [(0, 0), (0, 0)],
    {"a": 1}, object(), int, len, range(3), iter(()), ..., 1 + 2j, np.zeros(0), np.zeros((2, 2)), np.eye(3),
    np.array([1j]), np.array(["a"]), np.zeros((0, 2)), np.float32(1.5), np.datetime64("now"), np.ma.masked,
    np.full((3, 2), 1e12), np.zeros((3, 2), dtype=object), [BEACON, 3], [[PATH]], "office", "missing.csv", "/dev/null",
    ".", [WORLD], [DRIFT], {"a": DRIFT}, {1: 2}, [((1, 1), (1, 1), 1)],
)  # fmt: skip
SLOW = ("co_design", "beacon_tradeoff", "studio_widget", "pareto_routes", "plan_routes")  # seconds, if they work
RESULTS = (  # which no script makes
    "CoDesign", "Comparison", "DetectionChance", "Drift", "GraphRoute", "Layout", "NoiseFit", "OdometryLog",
    "PointDrift", "Preset", "Route", "SpatialDrift", "StudyResult",
)  # fmt: skip
ERRORS = tuple(
    name for name in d.__all__ if isinstance(getattr(d, name), type) and issubclass(getattr(d, name), BaseException)
)
LIMITED = ("time_limit", "iterations", "max_nodes", "resamples", "rounds", "workers", "runs")  # always given
OBJECTS = MappingProxyType(
    {"World": WORLD, "Drift": DRIFT, "Route": ROUTE, "Layout": LAYOUT, "OdometryNoise": NOISE, "Beacon": BEACON}
)
_OURS = re.compile(
    r"expected|has no keyword|needs|cannot|no route|must|is not|outside|No such|nothing|should be|missing \d"
)


def targets() -> dict[str, Callable[..., Any]]:
    """Every public function, every class that a script makes, other constructors, and the methods of its objects."""
    found: dict[str, Callable[..., Any]] = {}
    for name in d.__all__:
        value = getattr(d, name)
        if isinstance(value, type) and not issubclass(value, BaseException):
            found |= {f"{name}.{k}": getattr(value, k) for k, of in vars(value).items() if isinstance(of, classmethod)}
            methods = {k for k, of in vars(value).items() if inspect.isfunction(of)} if name in OBJECTS else ()
            found |= {f"{name}.{method}": getattr(OBJECTS[name], method) for method in methods}
        if inspect.isfunction(value) or (isinstance(value, type) and name not in RESULTS + ERRORS):
            found[name] = value
    return {name: call for name, call in sorted(found.items()) if not re.search(r"\._", name)}


def arguments(call: Callable[..., Any], rng: random.Random) -> dict[str, Any]:
    """What a call is given: most of what has to be there is right, and a few of the other parameters are given too."""
    given = {}
    odd = rng.choice((0.1, 0.3, 1.0))
    for name, parameter in inspect.signature(call).parameters.items():
        if parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
            continue
        asked = str(parameter.annotation)
        right = GOOD.get(
            name, GOOD.get(asked, GOOD.get(asked.removesuffix(" | None"), GOOD.get(asked.split(" | ")[0])))
        )
        if parameter.default is not parameter.empty and name not in LIMITED:
            if rng.random() < 0.8:
                continue
            right = parameter.default
        given[name] = rng.choice(ODD) if rng.random() < odd else right
    return given


def fault_of(call: Callable[..., Any], given: dict[str, Any]) -> str | None:
    """What went wrong with a call, if anything did."""
    try:
        with (
            limited(SECONDS),
            warnings.catch_warnings(),
            redirect_stdout(io.StringIO()),
            redirect_stderr(io.StringIO()),
        ):
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", UserWarning)  # that amcl's alphas are no physics, and matplotlib's
            call(**given)
    except (ValueError, TypeError, OSError, ImportError, d.DriftplanError) as err:
        if not isinstance(err, (d.DriftplanError, OSError)) and not _OURS.search(str(err)):
            return f"{type(err).__name__} in words that are not ours: {err} at {_place(err)}"
        if len(str(err)) > 1000:
            return f"a message of {len(str(err))} letters: {str(err)[:200]}"
    except (Exception, Hang) as err:
        return f"{err!r} at {_place(err)}"
    return None


def _place(error: BaseException) -> str:
    """Where in driftplan it was."""
    mine = [f for f in traceback.extract_tb(error.__traceback__) if "driftplan/" in f.filename]
    return f"{mine[-1].filename.split('driftplan/')[-1]}:{mine[-1].lineno}" if mine else "?"


def main(seed: int, count: int, names: list[str]) -> int:
    rng, faults, calls = random.Random(seed), 0, targets()
    limit_memory()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for k in range(count):
            name = (names or list(calls))[k % len(names or calls)]
            given = arguments(calls[name], rng)
            if name in SLOW and rng.random() < 0.9:
                continue
            fault = fault_of(calls[name], given)
            if fault is not None:
                faults += 1
                said = ", ".join(f"{key}={short(value)}" for key, value in given.items())
                print(f"{seed}-{k}: {name}({said})\n    {fault}", flush=True)
    return faults > 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]))
