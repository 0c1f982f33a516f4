"""The driftplan command as a process of its own: what only shows there is noise at exit, signals and closed pipes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

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
        ["compare", "office", *EASY, "--planner", "bitstar"],
    ],
    ids=" ".join,
)
def test_nothing_but_the_answer_is_printed_and_nothing_leaks(words):
    quick = [] if words == ["maps"] else ["--time-limit", "1"]
    done = command(*words, *quick, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["command"] == words[0]
    # OMPL would say Info:, Warning: or Debug:, nanobind would list what leaked
    assert all(line.startswith("planning") for line in done.stderr.splitlines()), done.stderr


def test_errors_are_one_line_without_traceback_or_leaks():
    done = command("plan", "office", "--start", "0,0", "--goal", "6,5", "--planner", "bitstar")
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
    scripts = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]["scripts"]
    assert scripts == {"driftplan": "driftplan.__main__:main"}


def test_an_interrupt_while_modules_load_is_no_traceback():
    code = (
        "import os, signal, sys\n"
        "class Stop:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'driftplan.report.cli': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Stop())\n"
        "import driftplan.__main__"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")


LOST_IN_A_CALLBACK = (
    "    held = {1}\n    seen = weakref.ref(held, lambda _: signal.raise_signal(signal.SIGINT))\n    del held\n"
)
TAKEN_FOR_A_BROKEN_MODULE = (
    "    class Broken:\n"
    "        def find_spec(self, name, path=None, target=None):\n"
    "            try: signal.raise_signal(signal.SIGINT)\n"
    "            except BaseException: raise ImportError('broken') from None\n"
    "    sys.meta_path.insert(0, Broken())\n"
    "    try: import wave\n"
    "    finally: sys.meta_path.pop(0)\n"
)


@pytest.mark.parametrize("work", [LOST_IN_A_CALLBACK, TAKEN_FOR_A_BROKEN_MODULE], ids=["callback", "import"])
def test_an_interrupt_that_is_lost_comes_again(work):
    code = (
        "import signal, sys, time, weakref; from dataclasses import replace\n"
        "signal.signal(signal.SIGINT, signal.SIG_DFL)\n"
        "from driftplan.report import cli\n"
        f"def run(args):\n{work}"
        "    time.sleep(30)\n"
        "cli.COMMANDS['maps'] = replace(cli.COMMANDS['maps'], run=run)\n"
        "sys.exit(cli.main(['maps']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=20)
    assert (done.returncode, done.stderr) == (130, "driftplan maps: interrupted; no file was left half written\n")


@pytest.mark.parametrize(
    ("redirected", "code", "said"),
    [
        (">&-", 2, "driftplan: standard output is closed: expected somewhere to print to, such as > /dev/null\n"),
        ("> /dev/full", 2, "driftplan maps: [Errno 28] No space left on device\n"),
        ("2>&- >/dev/null", 0, ""),
    ],
)
def test_streams_that_are_closed_or_full_are_said_in_one_line(redirected, code, said):
    line = f"exec {sys.executable} -m driftplan maps {redirected}"
    done = subprocess.run(["sh", "-c", line], stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (code, said)


def test_signs_that_a_terminal_does_not_know_are_no_error():
    code = "import sys; from driftplan.report.cli import _check_streams; _check_streams(); print('1 ± 2')"
    ascii_only = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, env=ascii_only, check=True)
    assert done.stdout == b"1 \\xb1 2\n"
