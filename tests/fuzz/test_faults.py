"""Commands that are killed, interrupted, or have no room: nothing is half written, nothing is left over."""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import sys
import time

import pytest

from tests.fuzz.seeds import SEEDS

KILLS = int(os.environ.get("DRIFTPLAN_KILLS", 9))  # each takes seconds
FILES = {seed.name: seed.content for seed in SEEDS} | {"route.csv": b"x,y\n1,1\n8,1\n8,8\n"}
OLD = b"what was there before\n"
LINES = (  # every subcommand that writes, and what it writes
    ("plan m.geojson --start 1,1 --goal 8,8 --noise noise.yaml --iterations 1 --csv a.csv --picture a.png", 2),
    ("compare m.geojson route.csv --start 1,1 --goal 8,8 --noise noise.yaml --iterations 1 --picture a.png", 1),
    ("place m.geojson route.csv --noise noise.yaml --max-drift 0.3 --geojson a.geojson --csv a.csv --table a.html", 3),
    ("studio m.geojson route.csv --beacons tags.geojson --noise noise.yaml --html a.html", 1),
    ("graph graph.geojson --noise noise.yaml --geojson a.geojson", 1),
    ("fit speeds.csv truth.csv --accept-faults --yaml a.yaml", 1),
    ("examples new", 0),
    ("study init a.yaml", 0),
    ("demo", 0),
)


def start(words, folder, **options):
    """The command in a process of its own, in a folder with all it reads and something where it writes."""
    for name, content in FILES.items():
        (folder / name).write_bytes(content)
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE} | options
    env = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen([sys.executable, "-m", "driftplan", *words], cwd=folder, env=env, **quiet)


def outputs(words, folder):
    """The files that a command line names for writing."""
    return [folder / word for word in words if word.startswith("a.")]


def check_whole(paths, done):
    """Every file is the old one or the new one, whole."""
    for path in paths:
        assert path.read_bytes() in (OLD, done[path.name]), path.name


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """What every line writes undisturbed."""
    found = {}
    for line, count in LINES:
        if count:
            folder = tmp_path_factory.mktemp("good")
            words = line.split()
            process = start(words, folder)
            _, err = process.communicate(timeout=300)
            assert process.returncode == 0, err
            found[line] = {path.name: path.read_bytes() for path in outputs(words, folder)}
            assert len(found[line]) == count
    return found


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGINT], ids=["killed", "interrupted"])
def test_nothing_is_half_written_whenever_it_ends(sent, good, tmp_path):
    rng = random.Random(int(sent))
    for k in range(KILLS):
        line, count = LINES[k % len(LINES)]
        words, folder = line.split(), tmp_path / str(k)
        folder.mkdir()
        for path in outputs(words, folder) if count else ():
            path.write_bytes(OLD)
        process = start(words, folder)
        time.sleep(rng.uniform(0.1, 4.0))
        process.send_signal(sent)
        _, err = process.communicate(timeout=60)
        assert b"Traceback" not in err, err.decode()
        check_whole(outputs(words, folder) if count else (), good.get(line, {}))
        if sent == signal.SIGINT:
            assert process.returncode in (0, 130, -signal.SIGINT), (line, err)
            assert not list(folder.glob(".driftplan*"))


def full():
    """No file may grow beyond a kilobyte, as on a full disk."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024))


@pytest.mark.slow
@pytest.mark.parametrize("line", [line for line, count in LINES if count])
def test_a_full_disk_leaves_what_was_there(line, good, tmp_path):
    words = line.split()
    for path in outputs(words, tmp_path):
        path.write_bytes(OLD)
    process = start(words, tmp_path, preexec_fn=full)
    _, err = process.communicate(timeout=120)
    fits = all(len(content) <= 1024 for content in good[line].values())
    assert process.returncode == (0 if fits else 2), err
    assert b"Traceback" not in err
    if not fits:
        assert all(path.read_bytes() == OLD for path in outputs(words, tmp_path))
        assert b"File too large" in err
    assert not list(tmp_path.glob(".driftplan*"))
