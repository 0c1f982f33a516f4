"""Which small faults in the core the tests notice: ``make mutate``, or ``python -m tests.mutation [module ...]``.

A sample of the mutants of every module in ``CORE`` is run, each in a process of its own in which the module has one
fault, against those of the tests named for the module that call the faulty function, the quickest first. A mutant is
killed if a test fails, or needs much longer than without the fault. The score is written to ``score.md``; mutants that
change nothing that a test could see are listed in ``equivalent.txt``, with why, and do not count.
HYPOTHESIS_PROFILE=mutation is what the tests run under: the same examples as ever, not shrunk.
"""

from __future__ import annotations

import argparse
import importlib.abc
import importlib.util
import json
import os
import random
import resource
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path

from tests.mutation.mutants import Mutant, mutants_of

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
CORE = {  # module: the tests that should notice, the quickest first
    "model.moments": "model/test_moments.py model/test_elements.py",
    "model.elements": "model/test_elements.py model/test_drift.py",
    "model.covariance": "model/test_filter_state.py model/test_covariance.py model/test_filter_drift.py",
    "model.filter_state": "model/test_filter_state.py model/test_covariance.py model/test_filter_drift.py",
    "model.fusion": "model/test_fusion.py model/test_filter_drift.py model/test_between_drives.py",
    "model.readings": "model/test_readings.py model/test_fixes.py model/test_covariance.py model/test_filter_drift.py",
    "model.drive": "model/test_drive.py model/test_fixes.py model/test_filter_drift.py",
    "model.worst": "model/test_worst.py model/test_filter_drift.py",
    "planning.cost": "planning/test_cost.py",
    "planning.roadmap.fused_edges": "planning/test_itinerary_labels.py",
    "beacons.passes": "beacons/test_passes.py beacons/test_views.py beacons/test_beacon.py",
    "beacons.readings": "beacons/test_readings.py beacons/test_beacon.py beacons/test_views.py",
    "layouts.placement.covering": "layouts/test_covering_steps.py layouts/test_covering.py",
    "layouts.placement.cut_pool": "layouts/test_cut_pool.py layouts/test_covering_steps.py",
    "layouts.placement.cover_bounds": "layouts/test_cut_pool.py layouts/test_covering_steps.py",
    "layouts.placement.requirements": "layouts/test_requirement_rows.py layouts/test_requirements.py",
    "layouts.placement.exclusions": "layouts/test_exclusions.py",
    "layouts.placement.weighted_cuts": "layouts/test_fused_steps.py",
    "layouts.placement.fused_requirements": "layouts/test_fused_steps.py",
    "layouts.placement.fused_routes": "layouts/test_fused_steps.py layouts/test_fused_placement.py",
    "world.ros_map": "world/test_ros_map.py",
}
PATIENCE = 4.0  # times the processor seconds that the tests take without a fault


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description="Which faults do the tests notice?")
    parser.add_argument("modules", nargs="*", default=[], help=f"some of: {' '.join(CORE)}")
    parser.add_argument("--sample", type=int, default=40, help="mutants of each module (40)")
    parser.add_argument("--seed", type=int, default=0, help="of the sample (0)")
    parser.add_argument("--again", action="store_true", help="only what survived the last time; its score is made good")
    parser.add_argument("--minutes", type=float, default=60.0, help="after which no further mutant is tried (60)")
    args = parser.parse_args()
    if unknown := set(args.modules) - set(CORE):
        parser.error(f"no module {', '.join(sorted(unknown))}: one of {', '.join(CORE)}")
    end = time.monotonic() + 60 * args.minutes
    warm_up()
    for module in args.modules or CORE:
        report = try_module(module, args.sample, args.seed, end, args.again)
        keep(module, report)
        print(report, flush=True)
    return 0


def try_module(module: str, sample: int, seed: int, end: float, again: bool = False) -> str:
    """The score of one module: a line of a table, and the survivors. With ``again`` those of the last time are tried,
    and what was killed then counts as killed: good as long as tests are only added."""
    tests = [str(ROOT / "tests" / name) for name in CORE[module].split()]
    calls = Calls(str(file_of(module)))
    with tempfile.TemporaryDirectory() as folder:
        if run(None, tests, 1e4, calls, Path(folder) / "calls"):
            raise SystemExit(f"the tests of {module} fail without any fault")
        calls.read(Path(folder) / "calls")
    known = equivalent(module)
    mutants = mutants_of(file_of(module))
    random.Random(seed).shuffle(mutants)  # all, so that the sample hardly changes when some turn out equivalent
    mutants = [m for m in mutants if m.name not in known]
    tried, survivors, sampled = 0, [], mutants[:sample]
    if again:
        tried, survived = last_time(module)
        sampled = [m for m in mutants if m.name in survived]
    for mutant in sampled:
        if time.monotonic() > end and not again:
            break
        tried += 1
        chosen, seconds = calls.tests_of(mutant.function)
        if not chosen or not run((f"driftplan.{module}", mutant), chosen, PATIENCE * seconds + 5.0):
            survivors.append(f"    {file_of(module).name}:{mutant.line}  {mutant.name}")
            print("survives", survivors[-1], flush=True)
    share = (tried - len(survivors)) / max(tried, 1)
    of = f"of {len(mutants)} (and {len(known)} equivalent)"
    return "\n".join([f"{module:40} {tried - len(survivors):4} of {tried:4} {share:6.0%}  {of}", *sorted(survivors)])


def run(
    fault: tuple[str, Mutant] | None,
    tests: list[str],
    seconds: float,
    calls: Calls | None = None,
    calls_to: Path | None = None,
) -> int:
    """The exit status of the tests in a fork of this process, in which they may use so much of the processor."""
    if not (child := os.fork()):
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 2))
        signal.alarm(int(10 * seconds) + 1)  # for those that sleep
        if fault:  # what the tests say without one is worth reading
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            os.dup2(1, 2)
        status = _tests_pass(fault, tests, calls)
        if calls and calls_to:
            calls.write(calls_to)
        sys.stdout.flush()
        os._exit(status)
    return os.waitpid(child, 0)[1]


def _tests_pass(fault: tuple[str, Mutant] | None, tests: list[str], calls: Calls | None) -> int:
    import pytest

    try:
        if fault:
            sys.meta_path.insert(0, Faulty(*fault))
        plain = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-W", "ignore:Module already imported"]
        return int(pytest.main([*plain, f"--rootdir={ROOT}", *tests], plugins=[calls] if calls else []))
    except BaseException as err:  # a fault may show itself while a module is imported
        print(repr(err))
        return 1


class Calls:
    """A pytest plugin that notes which functions of a file each test calls, and its seconds of the processor."""

    def __init__(self, file: str):
        self.file = file
        self.functions: dict[str, set[str]] = {}  # by test
        self.seconds: dict[str, float] = {}

    def pytest_sessionstart(self, session):
        sys.settrace(self._note_elsewhere)  # from the first import on

    def pytest_runtest_logstart(self, nodeid, location):
        self.seconds[nodeid] = time.process_time()
        self.functions[nodeid] = set()
        self.now = self.functions[nodeid]
        sys.settrace(self._note)
        threading.settrace(self._note)  # of threads that begin

    def pytest_runtest_logfinish(self, nodeid, location):
        sys.settrace(None)
        threading.settrace(None)
        self.seconds[nodeid] = time.process_time() - self.seconds[nodeid]

    def pytest_fixture_setup(self, fixturedef, request):
        """What fixtures of wider scope call counts for every test."""
        if fixturedef.scope != "function":
            self.now = self.functions.setdefault("", set())

    def pytest_runtest_call(self, item):
        self.now = self.functions[item.nodeid]

    def _note(self, frame, event, arg):
        if frame.f_code.co_filename == self.file:
            self.now.add(frame.f_code.co_name)

    def _note_elsewhere(self, frame, event, arg):
        if frame.f_code.co_filename == self.file:
            self.functions.setdefault("", set()).add(frame.f_code.co_name)

    def write(self, file: Path) -> None:
        functions = {test: sorted(called) for test, called in self.functions.items()}
        file.write_text(json.dumps([functions, self.seconds]))

    def read(self, file: Path) -> None:
        functions, self.seconds = json.loads(file.read_text())
        self.functions = {test: set(called) for test, called in functions.items()}

    def tests_of(self, function: str) -> tuple[list[str], float]:
        """The tests that may notice a fault in a function, the quickest first, and the seconds they need."""
        called_anyway = function in self.functions.get("", ())
        tests = [test for test in self.seconds if called_anyway or function in self.functions[test]]
        tests.sort(key=self.seconds.__getitem__)
        return [str(ROOT / test) for test in tests], sum(self.seconds[test] for test in tests)


class Faulty(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports one module with its fault."""

    def __init__(self, module: str, mutant: Mutant):
        self.module, self.mutant = module, mutant

    def find_spec(self, fullname, path, target=None):
        if fullname == self.module:
            return importlib.util.spec_from_file_location(
                fullname, file_of(self.module.removeprefix("driftplan.")), loader=self
            )
        return None

    def exec_module(self, module):
        exec(compile(self.mutant.source(), module.__file__, "exec"), module.__dict__)


def warm_up() -> None:
    """Import what does not change, once for all forks."""
    os.environ |= {"HYPOTHESIS_PROFILE": "mutation", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    os.nice(10)
    heavy = "numpy scipy.optimize scipy.sparse scipy.spatial scipy.stats shapely yaml PIL.Image hypothesis ompl pytest"
    for name in heavy.split():
        importlib.import_module(name)
    assert "driftplan.model" not in sys.modules


def file_of(module: str) -> Path:
    return ROOT / "driftplan" / f"{module.replace('.', '/')}.py"


def equivalent(module: str) -> set[str]:
    """Names of the mutants of a module that behave as the module does; their reason stands after a tab."""
    lines = (line.split("\t") for line in (HERE / "equivalent.txt").read_text().splitlines() if line[:1] not in "#")
    return {name for of, name, _ in lines if of == module}


SCORE = HERE / "score.md"


def scores() -> tuple[str, dict[str, str]]:
    """The head of ``score.md`` and what it says of each module."""
    head, *parts = SCORE.read_text().split("\n\n### ") if SCORE.exists() else ["# Mutants that the tests notice"]
    return head, {part.split("\n")[0].split()[0]: part.rstrip() for part in parts}


def last_time(module: str) -> tuple[int, set[str]]:
    """How many mutants of a module the tests noticed the last time, and the names of those that they did not."""
    head, *lines = scores()[1][module].splitlines()
    return int(head.split()[1]), {line.strip().split("  ", 1)[1] for line in lines}


def keep(module: str, report: str) -> None:
    """Put the score of a module in its place in ``score.md``."""
    head, found = scores()
    found[module] = report
    SCORE.write_text("\n\n### ".join([head.rstrip(), *(found[name] for name in CORE if name in found)]) + "\n")


if __name__ == "__main__":
    sys.exit(main())
