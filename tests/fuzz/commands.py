"""Runs the command in one process on many broken command lines and files, and prints those that went wrong.

``python -m tests.fuzz.commands SEED COUNT``. A command line is a good one with values of options, options and
files changed. It may end with the exit codes that are documented, and if it fails with one line on stderr that begins
with the program's name; it may not raise, and not take more than its seconds of the processor.
"""

from __future__ import annotations

import io
import os
import random
import sys
import tempfile
import traceback
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from driftplan.report.cli import main as driftplan
from driftplan.report.commands import COMMANDS
from driftplan.report.commands.option import Option
from tests.fuzz.files import Hang, limit_memory, limited
from tests.fuzz.mutations import NUMBERS, mutated
from tests.fuzz.seeds import SEEDS

SECONDS = 10.0
CODES = (0, 2, 3)
LINES = (  # all of them good
    "predict route.csv --noise noise.yaml",
    "predict route.csv poses.txt --noise noise.yaml --at 1,2",
    "plan m.geojson --start 1,1 --goal 8,8 --noise noise.yaml --time-limit 1",
    "plan m.yaml --start 0,2.5 --goal 2.3,4.3 --noise noise.yaml --robot-radius 0.1 --time-limit 1",
    "plan m.geojson --start 1,1 --goal 8,8 --beacons tags.geojson --estimator filter --max-drift 1 --time-limit 1",
    "compare m.geojson route.csv --noise noise.yaml",
    "place m.geojson route.csv --noise noise.yaml --max-drift 0.3 --range-m 2 --position-std-m 0.1 --time-limit 1",
    "place m.geojson route.csv --estimator filter --candidates tags.geojson --max-drift 9 --time-limit 1",
    "fit speeds.csv truth.csv --accept-faults --json",
    "graph graph.geojson --noise noise.yaml --start-node 0 --goal-node 2",
    "maps",
)
_FILES = {seed.name: seed.content for seed in SEEDS} | {
    name: content for seed in SEEDS for name, content in seed.beside.items()
}
_FILES |= {"route.csv": b"x,y\n1,1\n8,1\n8,8\n", "poses.txt": b"0 0 0\n5 0 1.57\n5 4 3.1\n"}
_KNOWN = (  # faults that wait to be mended: printed, not counted
    "in bootstrap>",  # --accept-faults on a drive of 40 rows with one absurd speed overflows
)
_NEVER = ("planner", "time_limit", "iterations", "tradeoff")  # these may take their time


def broken(line: str, rng: random.Random) -> tuple[list[str], dict[str, bytes]]:
    """A command line with one to three changes, and the files it names."""
    words, files = line.split(), dict(_FILES)
    options = [o for o in COMMANDS[words[0]].options if o.name not in _NEVER]
    for _ in range(rng.choice((1, 1, 2, 3))):
        change = rng.random()
        named = [word for word in words if word in files]
        values = [k for k, word in enumerate(words) if words[k - 1] in {o.flag for o in options}]
        if change < 0.4 and named:
            name = rng.choice(named)
            files[name] = mutated(files[name], rng, rng.choice(SEEDS).content)
        elif change < 0.7 and values:
            words[rng.choice(values)] = rng.choice((*NUMBERS, "1,2,3", "1,nan", "missing.csv", "/dev/null", "."))
        elif change < 0.95 and options:
            words += _option(rng.choice(options), rng)
        else:
            at = [k for k in range(len(words)) if words[k - 1] not in ("--time-limit", "--iterations")]
            words[rng.choice(at)] = rng.choice((*NUMBERS, *named, "--json", "--help"))
    return words, files


def _option(option: Option, rng: random.Random) -> list[str]:
    if option.choices:
        return [option.flag, str(rng.choice((*option.choices, "")))]
    if not option.unit:
        return [option.flag]
    return [option.flag, rng.choice(("0.1", "1", "2", "90", "1,1", "noise.yaml", "tags.geojson", *NUMBERS))]


def fault_of(words: list[str], files: dict[str, bytes], folder: Path, codes: tuple[int, ...] = CODES) -> str | None:
    """What went wrong with a command, if anything did; ``codes`` it may end with."""
    for name, content in files.items():
        (folder / name).write_bytes(content)
    os.chdir(folder)
    sys.stdin = io.StringIO("")
    out, err = io.StringIO(), io.StringIO()
    try:
        with redirect_stdout(out), redirect_stderr(err), warnings.catch_warnings(), limited(SECONDS):
            warnings.simplefilter("error")
            code = driftplan(words)
    except SystemExit as stop:
        code = stop.code
    except (Exception, Hang) as error:
        return f"{error!r} at {traceback.extract_tb(error.__traceback__)[-1]}"
    last = err.getvalue().strip().split("\n")[-1]
    if code not in codes:
        return f"exit code {code}: {err.getvalue()[-300:]}"
    if code and not last.startswith("driftplan"):
        return f"failed without a word of its own: {last[:300]!r}"
    if left := [name for name in os.listdir(folder) if name.startswith(".driftplan")]:
        return f"left {left}"
    return None


def main(seed: int, count: int) -> int:
    rng, faults, home = random.Random(seed), 0, os.getcwd()
    for k in range(-len(LINES), count):
        if k == 0:
            limit_memory()
        line = LINES[k % len(LINES)]
        words, files = broken(line, rng) if k >= 0 else (line.split(), dict(_FILES))
        with tempfile.TemporaryDirectory() as folder:
            fault = fault_of(words, files, Path(folder), CODES if k >= 0 else (0,))
            os.chdir(home)
        if fault is not None:
            faults += not any(known in fault for known in _KNOWN)
            changed = {name: files[name] for name in words if name in files and files[name] != _FILES[name]}
            print(f"{seed}-{k}: driftplan {' '.join(words)[:500]}  {changed}\n    {fault}", flush=True)
    return faults > 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2])))
