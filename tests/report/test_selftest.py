"""driftplan selftest: it passes where all is well, and notices a formula that is broken."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace

import pytest

from driftplan.model.drift import Drift, PointDrift
from driftplan.report.commands import selftest
from driftplan.world.world import World

TEST_EXTRAS = ("pytest", "hypothesis", "mpmath", "pandas", "filterpy", "ezdxf", "rosbags", "anywidget", "distributed")


@pytest.mark.slow
def test_a_healthy_copy_passes_without_the_libraries_of_tests():
    code = (
        "import sys\n"
        f"for name in {TEST_EXTRAS}: sys.modules[name] = None\n"
        "from driftplan.report.cli import main\n"
        "sys.exit(main(['selftest', '--json']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    said = json.loads(done.stdout)
    assert said["passed"]
    assert {check["part"] for check in said["checks"]} == set(selftest._PARTS)
    assert "numpy" in said["versions"]


def doubled(function):
    return lambda *args, **given: 2 * function(*args, **given)


def broken_rms(monkeypatch):
    monkeypatch.setattr(PointDrift, "rms", property(lambda self: 1.01 * self.moments.N.real**0.5))


def broken_turns(monkeypatch):
    from driftplan.model import elements

    turns = elements.turn_moments
    monkeypatch.setattr(elements, "turn_moments", lambda turn, noise: turns(0.5 * turn, noise))
    monkeypatch.setattr("driftplan.model.readings.Resets.apply", lambda self, before: before)


def broken_walls(monkeypatch):
    free = World.free.func
    monkeypatch.setattr(World, "free", property(lambda self: free(self).buffer(-1.0)))


def broken_search(monkeypatch):
    from driftplan.layouts import layout

    monkeypatch.setattr(layout.Layout, "lower_bound", property(lambda self: 1.0), raising=False)


def broken_fit(monkeypatch):
    from driftplan.model.calibration import fit

    found = fit.fit_noise
    monkeypatch.setattr(
        "driftplan.fit_noise",
        lambda *args, **given: replace(
            found(*args, **given), intervals={name: (0.5, 0.6) for name in selftest_names()}
        ),
    )


def selftest_names():
    return ("heading_var_per_m", "distance_var_per_m", "distance_scale_error")
