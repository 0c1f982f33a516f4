"""One frame of a drag in the studio: 60 routes and 200 tags in the bundled warehouse, in a headless Chromium.

Main thread's processor time of computing and drawing (the picture itself is made elsewhere), so that other load counts
little; a frame of a screen at 60 Hz is 16 ms.

    python -m tests.benchmarks page
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from driftplan import Beacon, BeaconKind, OdometryNoise, bundled_map, load_world
from driftplan.page.document import page
from driftplan.page.scene import scene_of
from tests.page.browser import Browser, chromium

NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
TAG = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
FRAMES = 100
STUDIO = "const studio = document.getElementById('studio').studio, { session } = studio;"
DRAG = f"""(() => {{ {STUDIO} const t = performance.now();
for (let i = 0; i < {FRAMES}; i++) {{
  session.changeBeacon(0, {{ x: session.scene.beacons[0].x + 0.01 }}, "drag");
  studio.frame();
}} return (performance.now() - t) / {FRAMES}; }})()"""
NOISIER = DRAG.replace(
    'session.changeBeacon(0, { x: session.scene.beacons[0].x + 0.01 }, "drag")',
    'session.edit({ noise: { ...session.scene.noise, heading_var_per_m: 1e-4 + i * 1e-7 } }, "noise")',
)
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
            for said, frames in ((f"dragging a tag on {touched} routes", DRAG), ("changing the noise of all", NOISIER)):
                browser.js(frames)  # warm
                before = _thread_s(browser)
                wall_ms = browser.js(frames)
                cpu_ms = (_thread_s(browser) - before) / FRAMES * 1e3
                print(f"{estimator:6}  {said:30} {cpu_ms:6.1f} ms of processor, {wall_ms:6.1f} ms of wall a frame")
    browser.close()


def _thread_s(browser: Browser) -> float:
    metrics = browser.call("Performance.getMetrics")["metrics"]
    return next(one["value"] for one in metrics if one["name"] == "ThreadTime")


if __name__ == "__main__":
    main()
