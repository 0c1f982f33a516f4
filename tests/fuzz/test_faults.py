"""Commands that are killed, interrupted, or have no room: nothing is half written, nothing is left over."""

from __future__ import annotations

import ctypes
import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
import urllib.request
from functools import partial

import pytest

from tests.fuzz.seeds import SEEDS

STUDY = b"""\
map: m.geojson
noise: {heading_deg: 2, distance_m: 0.05}
trips: {random: 2}
beacon: {kind: rfid, range_m: 2, position_std_m: 0.1}
sites: {spacing_m: 1}
vary:
  limit_m: {from: 0.8, to: 1.4, count: 6}
"""
FILES = {seed.name: seed.content for seed in SEEDS} | {"route.csv": b"x,y\n1,1\n8,1\n8,8\n", "s.yaml": STUDY}
FILES["ways.csv"] = b"start_x,start_y,goal_x,goal_y\n1,1,8,1\n1,1,8,8\n"
OLD = b"what was there before\n"
LINES = (  # every subcommand that writes, and what it writes
    ("plan m.geojson --start 1,1 --goal 8,8 --noise noise.yaml --iterations 1 --csv a.csv --picture a.png", 2),
    ("compare m.geojson route.csv --start 1,1 --goal 8,8 --noise noise.yaml --iterations 1 --picture a.png", 1),
    ("place m.geojson route.csv --noise noise.yaml --max-drift 0.3 --geojson a.geojson --csv a.csv --table a.html", 3),
    ("studio m.geojson route.csv --beacons tags.geojson --noise noise.yaml --html a.html", 1),
    ("graph graph.geojson --noise noise.yaml --geojson a.geojson", 1),
    ("fit speeds.csv truth.csv --accept-faults --yaml a.yaml", 1),
    ("predict route.csv --noise noise.yaml --picture a.svg", 1),
    ("design m.geojson ways.csv --noise noise.yaml --max-drift 1 --price-per-m 1 --range-m 2 --position-std-m 0.1 "
     "--rounds 1 --geojson a.geojson --csv a.csv", 2),
    ("study run s.yaml --workers 1", 0),
    ("studio m.geojson route.csv --noise noise.yaml --no-browser --save saved.geojson", 0),
    ("examples new", 0),
    ("study init a.yaml", 0),
    ("demo", 0),
)  # fmt: skip
KILLS = int(os.environ.get("DRIFTPLAN_KILLS", len(LINES)))  # each takes seconds
WRITING = [line for line, count in LINES if count]


def start(words, folder, **options):
    """The command in a process of its own, in a folder with all it reads and something where it writes."""
    for name, content in FILES.items():
        (folder / name).write_bytes(content)
    heeding = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # though the tests run in a shell's background
    options = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "preexec_fn": heeding} | options
    env = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    line = [sys.executable, "-m", "driftplan", *words]
    return subprocess.Popen(line, cwd=folder, env=env, **options)


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
        rows = (folder / "s.results.jsonl").read_bytes() if (folder / "s.results.jsonl").exists() else b""
        assert all(json.loads(row)["key"] for row in rows.split(b"\n")[:-1])  # what follows the last end may be half
        if sent == signal.SIGINT:
            assert process.returncode in (0, 130, -signal.SIGINT), (line, err)
            assert not list(folder.glob(".driftplan*"))


def full():
    """No file may grow beyond a kilobyte, as on a full disk."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024))


@pytest.mark.slow
@pytest.mark.parametrize("line", WRITING)
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


def read_only():
    """Nothing may be written into the folder, not even by root, who has no say over modes without this capability."""
    os.chmod(".", 0o555)
    drop_from_bounds, overrides_modes = 24, 1  # PR_CAPBSET_DROP and CAP_DAC_OVERRIDE of Linux
    ctypes.CDLL(None).prctl(drop_from_bounds, overrides_modes, 0, 0, 0)


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="modes do not bind root elsewhere")
@pytest.mark.parametrize("line", WRITING)
def test_a_folder_that_is_read_only_is_said(line, tmp_path):
    words = line.split()
    for path in outputs(words, tmp_path):
        path.write_bytes(OLD)
    process = start(words, tmp_path, preexec_fn=read_only)
    _, err = process.communicate(timeout=120)
    tmp_path.chmod(0o755)
    assert process.returncode == 2, err
    assert b"Permission denied" in err.splitlines()[-1]
    assert b"Traceback" not in err
    assert all(path.read_bytes() == OLD for path in outputs(words, tmp_path))
    assert not list(tmp_path.glob(".driftplan*"))


@pytest.mark.slow
@pytest.mark.parametrize("how", ["closed", "full"])
@pytest.mark.parametrize(
    "line", [line for line, _ in LINES if not line.startswith("studio m.geojson route.csv --noise")]
)
def test_a_stdout_that_is_closed_or_full_is_said_in_one_line(line, how, good, tmp_path):
    words = line.split()
    files = outputs(words, tmp_path) if line in WRITING else []
    for path in files:
        path.write_bytes(OLD)
    with open("/dev/full" if how == "full" else os.devnull, "w") as stdout:
        close = (lambda: os.close(1)) if how == "closed" else None
        process = start(words, tmp_path, stdout=stdout, preexec_fn=close)
        _, err = process.communicate(timeout=120)
    assert b"Traceback" not in err, err.decode()
    assert process.returncode in ((2,) if how == "closed" else (0, 2)), err  # 0: a command that prints nothing
    assert (b"standard output is closed" if how == "closed" else b"No space left") in err or process.returncode == 0
    check_whole(files, good.get(line, {}))
    assert not list(tmp_path.glob(".driftplan*"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "sent", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM], ids=["killed", "interrupted", "ended"]
)
def test_a_studio_that_is_open_leaves_nothing_and_says_no_more_than_that_it_closed(sent, tmp_path):
    words = ["studio", "m.geojson", "route.csv", "--noise", "noise.yaml", "--no-browser", "--save", "saved.geojson"]
    process = start(words, tmp_path)
    url = process.stderr.readline().decode().strip()
    with urllib.request.urlopen(url, timeout=60) as page:
        assert page.status == 200
    process.send_signal(sent)
    _, err = process.communicate(timeout=60)
    assert process.returncode == (0 if sent == signal.SIGINT else -sent)
    assert b"Traceback" not in err
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(FILES)
