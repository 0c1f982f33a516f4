"""A study of 200 cells, done by processes and by a Dask cluster, each of which is killed again and again."""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from driftplan import run_study
from driftplan.layouts.study.run import planned_study

STUDY = """\
map: warehouse
noise: {heading_deg: 2, distance_m: 0.05}
trips: {random: 3}
beacon: {kind: rfid, range_m: 1.5, position_std_m: 0.1}
sites: {spacing_m: 3}
vary:
  limit_m: {from: 0.5, to: 1.4, count: 20}
  seed: {from: 1, to: 10}
"""
PATIENCE_S = 240.0  # of a loaded machine
TRIES = 3
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The study done by one process that nobody disturbs: its file and its rows."""
    file = tmp_path_factory.mktemp("alone") / "study.yaml"
    file.write_text(STUDY)
    return run_study(file, "processes", workers=1)


def start(module, *words, cwd):
    command = [sys.executable, "-m", module, *map(str, words)]
    with open(cwd / "stderr", "w") as said:
        return subprocess.Popen(command, cwd=cwd, stdout=subprocess.DEVNULL, stderr=said)


def children_of(process):
    """From Linux's table of processes."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == process:
            found.append(int(stat.parent.name))
    return found


def lines_in(file):
    return file.read_bytes().count(b"\n") if file.exists() else 0


def wait_for_more(file, before, process):
    """Until the file has grown, or the process has ended."""
    until = time.monotonic() + PATIENCE_S
    while lines_in(file) <= before and process.poll() is None:
        assert time.monotonic() < until
        time.sleep(0.02)


def check_rows(folder, alone):
    file = folder / "study.results.jsonl"
    keys = [json.loads(line)["key"] for line in file.read_text().splitlines()]
    assert len(keys) == len(set(keys)) == 200  # nothing lost, nothing done twice
    assert planned_study(folder / "study.yaml").to_dicts() == alone.to_dicts()


def cells_seconds(rows):
    return sum(row["spent"]["processor_s"] for row in rows.rows.values())


def children_seconds():
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def test_two_processes_do_what_one_does_at_the_same_cost(alone, tmp_path):
    """The efficiency that two cores of their own would have: processor time of one worker over that of two, start and
    routes planned twice included, times the share of the time in which both had a cell. Wall clocks cannot tell on a
    machine that others use; and since these slow each other down, by a tenth and more where they share a cache, the
    least of a few runs of each is taken, and less is asked for than is measured alone."""
    cost = {1: [], 2: []}
    for attempt in range(TRIES):
        for count in (1, 2):
            begin, before = time.monotonic(), children_seconds()
            rows = run_study(alone.study, "processes", workers=count, results=tmp_path / f"{attempt}.{count}.jsonl")
            wall = time.monotonic() - begin
            cost[count].append(children_seconds() - before)
            assert rows.to_dicts() == alone.to_dicts()
        at_work = sum(row["spent"]["seconds"] for row in rows.rows.values()) / (2 * wall)
        if min(cost[1]) / min(cost[2]) > 0.75:
            break
    assert min(cost[1]) / min(cost[2]) > 0.75
    assert at_work > 0.6  # what remains is the start of the workers, a second of a core


def test_killing_the_runner_and_its_workers_loses_nothing(alone, tmp_path):
    (tmp_path / "study.yaml").write_text(STUDY)
    rng, file, killed = random.Random(0), tmp_path / "study.results.jsonl", 0
    while killed < 10:
        runner = start("driftplan", "study", "run", "study.yaml", "--workers", 2, cwd=tmp_path)
        for victim in rng.sample(["worker", "worker", "runner"], 3):
            wait_for_more(file, lines_in(file) + rng.randrange(4), runner)
            time.sleep(rng.uniform(0, 0.2))
            workers = children_of(runner.pid)
            if runner.poll() is not None or (victim == "worker" and not workers):
                break
            os.kill(rng.choice(workers) if victim == "worker" else runner.pid, signal.SIGKILL)
            killed += 1
            if victim == "runner":
                break
        runner.kill()
        runner.wait()
        assert lines_in(file) < 200 or killed >= 10
    done = subprocess.run(
        [sys.executable, "-m", "driftplan", "study", "run", "study.yaml", "--workers", "2"], cwd=tmp_path
    )
    assert done.returncode == 0
    check_rows(tmp_path, alone)


class Cluster:
    """A Dask scheduler and two worker processes on the loopback address."""

    def __init__(self, folder):
        self.folder = folder
        self.address_file = folder / "scheduler.json"
        self.scheduler, self.workers = None, []
        self.mend()

    def mend(self):
        """Start what is dead."""
        if self.scheduler is None or self.scheduler.poll() is not None:
            self.address_file.unlink(missing_ok=True)
            words = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", self.address_file)
            self.scheduler = self._start("distributed.cli.dask_scheduler", *words)
            until = time.monotonic() + PATIENCE_S
            while not self._address():
                assert time.monotonic() < until
                time.sleep(0.1)
            for worker in self.workers:
                worker.kill()
        alive = [worker for worker in self.workers if worker.poll() is None]
        for _ in range(2 - len(alive)):
            words = ("--no-nanny", "--nthreads", "1", "--no-dashboard", "--local-directory", self.folder)
            alive.append(self._start("distributed.cli.dask_worker", self._address(), *words))
        self.workers = alive

    def _start(self, module, *words):
        command = [sys.executable, "-m", module, *map(str, words)]
        env = {**os.environ, "OMP_NUM_THREADS": "1"}
        return subprocess.Popen(command, cwd=self.folder, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def _address(self):
        try:
            return json.loads(self.address_file.read_text())["address"]
        except (OSError, ValueError):
            return None

    @property
    def address(self):
        return self._address()

    def close(self):
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path):
    pytest.importorskip("distributed")
    made = Cluster(tmp_path)
    yield made
    made.close()


def test_cells_on_a_cluster_of_two_workers_cost_what_they_do_in_one_process(alone, tmp_path, cluster):
    """Routes planned twice included; not the start of processes, nor what Dask does itself."""
    from distributed import Client

    there, alone_s = [], [cells_seconds(alone)]
    with Client(cluster.address) as client:
        client.wait_for_workers(2)
        for attempt in range(TRIES):
            rows = run_study(alone.study, client, results=tmp_path / f"{attempt}.jsonl")
            assert rows.to_dicts() == alone.to_dicts()
            there.append(cells_seconds(rows))
            if min(alone_s) / min(there) > 0.75:
                break
            again = run_study(alone.study, "processes", workers=1, results=tmp_path / f"{attempt}.1.jsonl")
            alone_s.append(cells_seconds(again))
    assert min(alone_s) / min(there) > 0.75


def test_killing_the_runner_workers_and_the_scheduler_of_a_cluster_loses_nothing(alone, tmp_path, cluster):
    (tmp_path / "study.yaml").write_text(STUDY)
    rng, file, killed = random.Random(1), tmp_path / "study.results.jsonl", 0
    victims = ["worker", "runner", "scheduler"] * 4
    while killed < 10:
        cluster.mend()
        runner = start("driftplan", "study", "run", "study.yaml", "--dask", cluster.address, cwd=tmp_path)
        wait_for_more(file, lines_in(file) + rng.randrange(6), runner)
        time.sleep(rng.uniform(0, 0.3))
        assert runner.poll() is None, (tmp_path / "stderr").read_text()
        victim = victims[killed]
        process = {"worker": rng.choice(cluster.workers), "runner": runner, "scheduler": cluster.scheduler}[victim]
        process.kill()
        process.wait()
        killed += 1
        if victim == "scheduler":
            assert runner.wait(PATIENCE_S) == 2
            assert "the Dask scheduler went away" in (tmp_path / "stderr").read_text()
        elif victim == "worker":
            wait_for_more(file, lines_in(file) + 2, runner)  # the other goes on
        runner.kill()
        runner.wait()
    assert lines_in(file) < 200
    cluster.mend()
    words = ("study", "run", "study.yaml", "--dask", cluster.address)
    assert start("driftplan", *words, cwd=tmp_path).wait(2 * PATIENCE_S) == 0
    check_rows(tmp_path, alone)
