"""Broken files and command lines: only what is documented comes of them. DRIFTPLAN_FUZZ=1000000 tries so many."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

import driftplan as d
from tests.fuzz.files import fault_of
from tests.fuzz.seeds import SEEDS

CASES = sorted((Path(__file__).parent / "cases").iterdir())
COUNT = int(os.environ.get("DRIFTPLAN_FUZZ", 0))
LOAD_S = float(os.environ.get("DRIFTPLAN_LOAD", 60))  # DRIFTPLAN_LOAD=600 asks one world for ten minutes
SEED = random.randrange(1000) if COUNT else 0  # the same files every day, others when many are asked for


@pytest.mark.parametrize("seed", SEEDS, ids=lambda seed: seed.name)
def test_the_good_files_are_read(seed, tmp_path):
    assert fault_of(seed, seed.content, tmp_path) is None
    seed.read(str(tmp_path / seed.name))  # and not refused


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_files_that_once_went_wrong(case, tmp_path):
    seed = next(seed for seed in SEEDS if seed.name == case.name.partition("-")[2])
    assert fault_of(seed, case.read_bytes(), tmp_path) is None


def run(module, *words):
    """What a process of its own says, which has little memory; it is started in the folder of the project."""
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-m", f"tests.fuzz.{module}", *map(str, words)],
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )
    return done.returncode, done.stdout + done.stderr


def test_a_limit_that_a_fusing_robot_breaks_only_while_turning_is_explained():
    tag = d.BeaconKind.landmark(2.0, 0.1, 0.05)
    tags = [d.Beacon(tag, x, 1.0) for x in (2.0, 8.0)]
    noise = d.OdometryNoise(heading_var_per_m=1e-4, distance_var_per_rad=65535.0)
    world = d.World.from_polygons([], bounds=(0, 0, 9, 9), robot_radius=0.1)
    with pytest.raises(d.InfeasibleError):
        d.place_beacons(world, [[(1, 1), (8, 1), (8, 8)]], noise, 0.5, d.Sites(points=tags), estimator="filter")


@pytest.mark.slow
def test_broken_files_of_every_format_are_read_or_refused_by_name(tmp_path):
    assert run("files", SEED, COUNT or 5000, tmp_path / "found") == (0, "")


@pytest.mark.slow
@pytest.mark.skipif(
    not COUNT, reason="what a search finds in its second depends on the machine: DRIFTPLAN_FUZZ=N tries"
)
def test_broken_command_lines_end_as_documented():
    status, said = run("commands", SEED, COUNT // 20 or 300)
    assert status == 0, said


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "count"), [("plan", 1000), ("place", 300), ("fit", 1000)])
def test_nothing_is_kept_of_what_is_done_again_and_again(kind, count):
    status, said = run("leaks", kind, count)
    assert status == 0, said


@pytest.mark.slow
def test_threads_and_processes_under_load_get_the_answers_of_one_alone():
    status, said = run("load", LOAD_S)
    assert status == 0, said


@pytest.mark.slow
def test_calls_with_anything_end_as_documented():
    assert run("calls", SEED, COUNT or 1500) == (0, "")
