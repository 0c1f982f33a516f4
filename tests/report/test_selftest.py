"""driftplan selftest: it passes where all is well, and notices what is broken."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from driftplan.layouts.placement.requirements import DriftRequirements
from driftplan.model import elements, filter_state
from driftplan.model.calibration.segment_sets import SegmentSet
from driftplan.model.readings import Resets
from driftplan.report.commands import selftest
from driftplan.world.inflation import Inflation

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


def unequal(length, curvature, noise, run_moments=elements.run_moments):
    return run_moments(length, curvature, noise.scaled(1.02))


def noisier(self, noise, windows=SegmentSet.windows):
    return windows(self, noise.scaled(3.0))


def twice(self, sites, route, slot, count=1, at_least=DriftRequirements._at_least):
    return at_least(self, sites, route, slot, count + 1)


BROKEN = {  # what is checked, and what is wrong: a run 2 % too noisy, a filter or robot that reads nothing, …
    "model": (elements, "run_moments", unequal),
    "simulation": (filter_state, "_read_row", lambda P, mean, row: None),
    "simulation ": (Resets, "apply", lambda self, before: before),
    "plan": (Inflation, "segments_free", lambda self, a, b: np.ones(a.shape[:-1], dtype=bool)),
    "placement": (DriftRequirements, "_at_least", twice),
    "fit": (SegmentSet, "windows", noisier),
}


@pytest.mark.parametrize("part", BROKEN)
def test_what_is_broken_is_noticed_with_exit_code_1(run, monkeypatch, part):
    monkeypatch.setattr(selftest, "_PARTS", {part.strip(): selftest._PARTS[part.strip()]})
    monkeypatch.setattr(selftest, "_DRIVES", 2000)
    monkeypatch.setattr(*BROKEN[part])
    code, out, _ = run("selftest")
    assert code == 1
    assert "FAILED" in out


def test_a_part_that_cannot_be_run_is_a_failure_and_the_others_go_on(run, monkeypatch):
    monkeypatch.setattr(selftest, "_PARTS", {"plan": lambda: iter([1 / 0]), "model": selftest._PARTS["model"]})
    code, out, _ = run("selftest", "--json")
    said = json.loads(out)
    assert (code, said["passed"]) == (1, False)
    assert [check["holds"] for check in said["checks"]] == [False, True, True, True]
    assert "ZeroDivisionError" in said["checks"][0]["what"]
