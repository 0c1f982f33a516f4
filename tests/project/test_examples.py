"""The examples run from top to bottom; notebooks keep their outputs and stay small enough to read."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import nbformat
import pytest

from driftplan.report.cli import build_parser
from driftplan.report.commands.shared import kind_from, noise_from

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda f: f.stem)
def test_notebooks_can_be_read_without_running_them(file):
    assert file.stat().st_size < 500_000
    cells = [cell for cell in nbformat.read(file, as_version=4).cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in cells)
    outputs = [output for cell in cells for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not [output for output in outputs if output.output_type == "error" or output.get("name") == "stderr"]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # what the notebook kernel's own libraries warn about
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda f: f.stem)
def test_notebooks_run(file):
    from nbclient import NotebookClient

    notebook = nbformat.read(file, as_version=4)
    NotebookClient(notebook, timeout=900, kernel_name="python3", resources={"metadata": {"path": EXAMPLES}}).execute()


def test_the_command_of_the_tags_notebook_asks_what_the_notebook_asks():
    """Noise, kind of beacon and limit; the cells are not run for it."""
    cells = nbformat.read(EXAMPLES / "warehouse_tags.ipynb", as_version=4).cells
    asked: dict[str, object] = {}
    exec("from driftplan import *", asked)
    for line in "\n".join(cell.source for cell in cells if cell.cell_type == "code").splitlines():
        if line.startswith(("noise = ", "marker = ", "LIMIT = ")):
            exec(line, asked)
    (command,) = re.findall(r"^driftplan (design .*)$", cells[-1].source, re.MULTILINE)
    args = build_parser().parse_args(command.split())
    assert noise_from(args) == asked["noise"]
    assert (args.max_drift, args.redundancy, args.min_capture, args.price_per_m) == (asked["LIMIT"], 2, 0.0, 1.0)
    given, wanted = kind_from(args, cost=args.beacon_price), asked["marker"]
    assert given.heading_std == pytest.approx(wanted.heading_std, abs=1e-5)
    assert replace(given, heading_std=wanted.heading_std, name=wanted.name) == wanted


@pytest.mark.slow
@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*.py")), ids=lambda f: f.stem)
def test_scripts_run_and_leave_nothing_behind(file):
    done = subprocess.run([sys.executable, str(file)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # neither OMPL's talk nor leak reports
    assert "rms" in done.stdout
