"""One frame of a drag in the studio: 60 routes and 200 tags in the bundled warehouse, in a headless Chromium; and how
long a notebook waits for Python to plan one route.

Main thread's processor time of computing, drawing and showing, frames as the browser schedules them, and that of all
threads and processes of the browser, without a graphics card: what a card would draw is drawn by the processor here. A
frame of a screen at 60 Hz is 16 ms.

    python -m tests.benchmarks page
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

import numpy as np

from driftplan import Beacon, BeaconKind, OdometryNoise, World, bundled_map, load_world, plan_route
from driftplan.page.scene import page, scene_of
from driftplan.report.studio import Answers
from tests.page.browser import Browser, chromium

NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
TAG = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
FRAMES = 100
STUDIO = "const studio = document.getElementById('studio').studio, { session } = studio;"
SHOWN = f"""(() => {{ {STUDIO} return new Promise((done) => {{
  let i = 0;
  const step = () => {{ if (i++ === {FRAMES}) return done(); EDIT; requestAnimationFrame(step); }};
  step();
}}); }})()"""
COMPUTED = f"(() => {{ {STUDIO} for (let i = 0; i < {FRAMES}; i++) {{ EDIT; studio.frame(); }} }})()"
DRAGGED = 'session.changeBeacon(0, { x: session.scene.beacons[0].x + 0.01 }, "drag")'
NOISIER = 'session.edit({ noise: { ...session.scene.noise, heading_var_per_m: 1e-4 + i * 1e-7 } }, "noise")'
TOUCHED = f"""(() => {{ {STUDIO} const [first] = session.scene.beacons;
return session.scene.routes.filter((route) => studio.calculator.readingsOn(route, first).length).length; }})()"""


def main() -> None:
    if chromium() is None:
        print("no Chromium on PATH")
        return
    world, rng = load_world(bundled_map("warehouse"), robot_radius=0.3), np.random.default_rng(3)
    low, high = np.reshape(world.bounds, (2, 2))
    routes = [rng.uniform(low, high, (6, 2)) for _ in range(60)]
    beacons = [Beacon(TAG, *rng.uniform(low, high), id=f"S{k}") for k in range(200)]
    browser = Browser()
    with tempfile.TemporaryDirectory() as folder:
        for estimator in ("reset", "filter"):
            file = Path(folder, f"{estimator}.html")
            scene = scene_of(world, routes, NOISE, beacons=beacons, limits=[2.0] * 60, estimator=estimator)
            file.write_bytes(page(scene))
            browser.open(file.as_uri(), 1600, 1000)
            browser.call("Performance.enable", timeDomain="threadTicks")
            touched = browser.js(TOUCHED)
            for said, edit in (
                (f"dragging a tag on {touched} routes", DRAGGED),
                ("changing the noise of all", NOISIER),
            ):
                (drawn, _), (shown, everywhere) = (
                    _spent_ms(browser, frames.replace("EDIT", edit)) for frames in (COMPUTED, SHOWN)
                )
                print(
                    f"{estimator:6}  {said:30} {drawn:5.1f} ms to compute and draw, {shown:5.1f} until shown, "
                    f"{everywhere:5.1f} on all threads"
                )
    browser.close()
    round_trip(world)


def round_trip(world: World) -> None:
    """A route asked for by the page, as the widget's message handler answers it."""
    answers, spent, first = Answers(world=world), [], []
    scene = scene_of(world, [np.array([[3.0, 3.0], [50.0, 30.0]])], NOISE)
    for k in range(5):
        start, goal = (3.0 + k, 3.0), (56.0, 36.0 - k)
        begin = time.process_time()
        plan_route(world, goal, start, NOISE)  # a trip of its own: a world keeps what was planned on it
        planned = time.process_time()
        question = {"scene": scene, "start": start, "goal": goal}
        assert "routes" in answers.answer("plan", question, lambda _: first.append(time.process_time()))["answer"]
        spent.append((planned - begin, first[-1] - planned, time.process_time() - planned))
    alone, soon, asked = 1e3 * np.median(spent, axis=0)
    print(
        f"a route asked for by the page: {soon:.0f} ms of processor until it is there, {asked:.0f} for the best, "
        f"where plan_route alone takes {alone:.0f}"
    )


def _spent_ms(browser: Browser, frames: str) -> tuple[float, float]:
    """Milliseconds of processor of a frame, once warm: of the main thread, and of all."""
    browser.js(frames)
    thread, everyone = _thread_s(browser), _all_s(browser.process.pid)
    browser.js(frames)
    thread, everyone = _thread_s(browser) - thread, _all_s(browser.process.pid) - everyone
    return thread / FRAMES * 1e3, everyone / FRAMES * 1e3


def _all_s(process: int) -> float:
    """Of a process and those that it has started (Linux)."""
    own = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    return sum(map(int, own[11:13])) / os.sysconf("SC_CLK_TCK") + sum(_all_s(int(child)) for child in children)


def _thread_s(browser: Browser) -> float:
    metrics = browser.call("Performance.getMetrics")["metrics"]
    return next(one["value"] for one in metrics if one["name"] == "ThreadTime")


if __name__ == "__main__":
    main()
