"""The driftplan command as a process of its own: what only shows there is noise at exit, signals and closed pipes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import pytest

DRIFTPLAN = [sys.executable, "-m", "driftplan"]
EASY = ["--start", "2,17", "--goal", "32,16.5"]  # along a corridor: any planner finds it at once
TRIP = ["--start", "36,12", "--goal", "6,5"]


def command(*words, **options):
    return subprocess.run([*DRIFTPLAN, *words], capture_output=True, text=True, timeout=120, check=False, **options)


@pytest.mark.parametrize(
    "words",
    [
        ["maps"],
        ["plan", "office", *EASY],
        ["plan", "office", *EASY, "--planner", "rrtstar"],
        ["compare", "office", *EASY, "--planner", "bitstar"],
    ],
    ids=" ".join,
)
def test_nothing_but_the_answer_is_printed_and_nothing_leaks(words):
    quick = [] if words == ["maps"] else ["--time-limit", "3"]
    done = command(*words, *quick, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["command"] == words[0]
    # OMPL would say Info:, Warning: or Debug:, nanobind would list what leaked
    assert all(line.startswith("planning") for line in done.stderr.splitlines()), done.stderr


@pytest.mark.parametrize("planner", ["bitstar", "roadmap"])
def test_errors_are_one_line_without_traceback_or_leaks(planner):
    done = command("plan", "office", "--start", "0,0", "--goal", "6,5", "--planner", planner)
    assert done.returncode == 2
    assert done.stdout == ""
    talk, error = done.stderr.splitlines()
    assert talk.startswith("planning")
    assert error.startswith("driftplan plan: start (0, 0) is not free")


@pytest.mark.parametrize("planner", ["roadmap", "bitstar"])
def test_ctrl_c_ends_in_one_line_with_nothing_half_written(planner, tmp_path):
    words = ["plan", "office", *TRIP, "--planner", planner, "--time-limit", "60", "--csv", str(tmp_path / "route.csv")]
    with subprocess.Popen(
        [*DRIFTPLAN, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(
            signal.SIGINT, signal.SIG_DFL
        ),  # a shell may have it ignored in the background
    ) as process:
        assert process.stderr.readline().startswith("planning")
        time.sleep(0.5)  # into the search
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)  # far less than the 60 s that it would take undisturbed
    # Python dies of the signal itself when it hit an `exec`, such as that of a dataclass; for a shell both are 130
    assert process.returncode in (130, -signal.SIGINT)
    assert (out, err) == ("", "driftplan plan: interrupted; no file was left half written\n")
    assert list(tmp_path.iterdir()) == []


def test_a_closed_pipe_is_no_error_to_talk_about():
    read, write = os.pipe()
    os.close(read)  # nobody listens, as after `| head -0`
    with os.fdopen(write, "wb") as deaf:
        done = subprocess.run([*DRIFTPLAN, "maps"], stdout=deaf, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 141
    assert done.stderr == ""


def test_help_loads_nothing_heavy():
    code = (
        "import sys; from driftplan.report.cli import main\n"
        "try: main(['plan', '--help'])\n"
        "except SystemExit: pass\n"
        "print([m for m in ('ompl', 'matplotlib', 'scipy', 'shapely', 'numpy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_the_drift_of_a_path_is_predicted_without_ompl_or_matplotlib(tmp_path):
    (tmp_path / "path.csv").write_text("x,y\n0,0\n1,0\n")
    code = (
        "import sys; from driftplan.report.cli import main\n"
        f"main(['predict', {str(tmp_path / 'path.csv')!r}])\n"
        "print([m for m in ('ompl', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_the_installed_command_is_the_module():
    from importlib.metadata import entry_points

    (script,) = [e for e in entry_points(group="console_scripts") if e.name == "driftplan"]
    assert script.value == "driftplan.report.cli:main"
