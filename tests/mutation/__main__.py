"""Which small faults in the core the tests notice: ``make mutate``, or ``python -m tests.mutation [module ...]``.

A sample of the mutants of every module in ``CORE`` is run, each in a process of its own in which the module has one
fault, against the tests that are named for it. A mutant is killed if a test fails, or needs much longer than without
the fault. The score is written to ``score.md``; mutants that change nothing that a test could see are listed in
``equivalent.txt``, with why, and do not count. HYPOTHESIS_PROFILE=mutation is what the tests run under: the same
examples as ever, not shrunk.
"""

from __future__ import annotations

import argparse
import importlib.abc
import importlib.util
import os
import random
import resource
import signal
import sys
import time
from pathlib import Path

from tests.mutation.mutants import Mutant, mutants_of

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
CORE = {  # module: the tests that should notice, the quickest first
    "model.moments": "model/test_moments.py model/test_elements.py",
    "model.elements": "model/test_elements.py model/test_drift.py",
    "model.covariance": "model/test_covariance.py model/test_filter_drift.py",
    "model.readings": "model/test_fixes.py model/test_covariance.py model/test_drift.py model/test_filter_drift.py",
    "model.drive": "model/test_fixes.py model/test_filter_drift.py model/test_drift.py",
    "model.worst": "model/test_worst.py model/test_filter_drift.py",
    "planning.cost": "planning/test_cost.py",
    "beacons.passes": "beacons/test_beacon.py beacons/test_views.py",
    "beacons.readings": "beacons/test_beacon.py beacons/test_views.py",
    "layouts.placement.covering": "layouts/test_covering.py",
    "layouts.placement.requirements": "layouts/test_requirements.py layouts/test_placement.py",
    "layouts.placement.weighted_cuts": "layouts/test_fused_placement.py",
    "layouts.placement.fused_requirements": "layouts/test_fused_placement.py",
    "world.ros_map": "world/test_ros_map.py",
}
PATIENCE = 4.0  # times the processor seconds that the tests take without a fault


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description="Which faults do the tests notice?")
    parser.add_argument("modules", nargs="*", default=[], help=f"some of: {' '.join(CORE)}")
    parser.add_argument("--sample", type=int, default=40, help="mutants of each module (40)")
    parser.add_argument("--seed", type=int, default=0, help="of the sample (0)")
    parser.add_argument("--minutes", type=float, default=60.0, help="after which no further mutant is tried (60)")
    args = parser.parse_args()
    if unknown := set(args.modules) - set(CORE):
        parser.error(f"no module {', '.join(sorted(unknown))}: one of {', '.join(CORE)}")
    end = time.monotonic() + 60 * args.minutes
    warm_up()
    for module in args.modules or CORE:
        report = try_module(module, args.sample, args.seed, end)
        keep(module, report)
        print(report, flush=True)
    return 0


def try_module(module: str, sample: int, seed: int, end: float) -> str:
    """The score of one module: a line of a table, and the survivors."""
    tests = [str(ROOT / "tests" / name) for name in CORE[module].split()]
    quiet, seconds = run(None, tests, 1e4)
    if quiet:
        raise SystemExit(f"the tests of {module} fail without any fault")
    known = equivalent(module)
    mutants = [m for m in mutants_of(file_of(module)) if m.name not in known]
    random.Random(seed).shuffle(mutants)
    tried, survivors = 0, []
    for mutant in mutants[:sample]:
        if time.monotonic() > end:
            break
        tried += 1
        if not run((f"driftplan.{module}", mutant), tests, PATIENCE * seconds + 5.0)[0]:
            survivors.append(f"    {file_of(module).name}:{mutant.line}  {mutant.name}")
            print("survives", survivors[-1], flush=True)
    share = (tried - len(survivors)) / max(tried, 1)
    return "\n".join([f"{module:40} {tried - len(survivors):4} of {tried:4} {share:6.0%}", *sorted(survivors)])


def run(fault: tuple[str, Mutant] | None, tests: list[str], seconds: float) -> tuple[int, float]:
    """The exit status of the tests in a fork of this process, in which they may use so much of the processor."""
    before = sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
    if not (child := os.fork()):
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 2))
        signal.alarm(int(10 * seconds) + 1)  # for those that sleep
        if fault:  # what the tests say without one is worth reading
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            os.dup2(1, 2)
        status = _tests_pass(fault, tests)
        sys.stdout.flush()
        os._exit(status)
    status = os.waitpid(child, 0)[1]
    return status, sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2]) - before


def _tests_pass(fault: tuple[str, Mutant] | None, tests: list[str]) -> int:
    import pytest

    try:
        if fault:
            sys.meta_path.insert(0, Faulty(*fault))
        plain = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-W", "ignore:Module already imported"]
        return int(pytest.main([*plain, f"--rootdir={ROOT}", *tests]))
    except BaseException as err:  # a fault may show itself while a module is imported
        print(repr(err))
        return 1


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


def keep(module: str, report: str) -> None:
    """Put the score of a module in its place in ``score.md``."""
    file = HERE / "score.md"
    head, *parts = file.read_text().split("\n\n### ") if file.exists() else ["# Mutants that the tests notice"]
    scores = {part.split("\n")[0].split()[0]: part.rstrip() for part in parts} | {module: report}
    file.write_text("\n\n### ".join([head.rstrip(), *(scores[name] for name in CORE if name in scores)]) + "\n")


if __name__ == "__main__":
    sys.exit(main())
