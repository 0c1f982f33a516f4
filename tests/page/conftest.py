"""The page's own code, run by node where there is one."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from driftplan import BeaconKind, OdometryNoise, Sites, World, Zone, place_beacons

from .browser import Browser, chromium

PAGE = Path(__file__).resolve().parents[2] / "driftplan/page"


@pytest.fixture(scope="session")
def javascript(tmp_path_factory):
    """A function that asks the page's code a question (tests/page/compute.mjs)."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node on PATH to run the page's JavaScript with")
    folder = tmp_path_factory.mktemp("page")
    for file in (*PAGE.glob("*.js"), Path(__file__).with_name("compute.mjs")):
        shutil.copy(file, folder)
    (folder / "package.json").write_text('{"type": "module"}')  # or node takes .js for something else
    process = subprocess.Popen(
        [node, "compute.mjs"], cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )

    def ask(what, **question):
        process.stdin.write(json.dumps({"ask": what, **question}, allow_nan=False) + "\n")
        process.stdin.flush()
        answer = process.stdout.readline()
        assert answer, "the page's code failed: see the error above"
        return json.loads(answer)

    yield ask
    process.stdin.close()
    process.stdout.close()
    process.wait(timeout=10)


@pytest.fixture(scope="session")
def _browser():
    if chromium() is None:
        pytest.skip("no Chromium on PATH: apt-get install chromium")
    one = Browser()
    yield one
    one.close()


@pytest.fixture
def browser(_browser):
    """A browser in which nothing may be complained about, and nothing asked of a network."""
    yield _browser
    assert _browser.complaints == []
    assert [url for url in _browser.requests if not url.startswith(("file://", "blob:", "http://127.0.0.1:"))] == []


@pytest.fixture(scope="session")
def layout():
    """Two routes about a wall, a floor that is bad, and tags that keep them under a limit."""
    floor = Zone([(8, 1), (14, 1), (14, 9), (8, 9)], OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3))
    wall = [(4, 4), (16, 4), (16, 4.4), (4, 4.4)]
    world = World.from_polygons([wall], bounds=(0, 0, 20, 12), robot_radius=0.3, zones=[floor])
    routes = [[(1, 2), (18, 2), (18, 8)], [(1, 9), (18, 9.5), (18, 6), (2, 6)]]
    noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
    tag = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    return place_beacons(world, routes, noise, 0.6, Sites(tag, spacing_m=1.0), time_limit=5)
