"""The examples run from top to bottom; notebooks keep their outputs and stay small enough to read."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import nbformat
import numpy as np
import pytest

from driftplan import load_trips
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


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda f: f.stem)
def test_notebooks_need_public_names_only(file):
    code = "\n".join(cell.source for cell in nbformat.read(file, as_version=4).cells if cell.cell_type == "code")
    assert not re.findall(r"^\s*(?:from|import) driftplan\..*$", code, re.MULTILINE)


def tags_notebook() -> tuple[str, list[nbformat.NotebookNode]]:
    """The command that the notebook ends with, and its cells."""
    cells = nbformat.read(EXAMPLES / "warehouse_tags.ipynb", as_version=4).cells
    (command,) = re.findall(r"```sh\n(driftplan design .*)\n```", cells[-1].source)
    return command, cells


def test_the_command_of_the_tags_notebook_asks_what_the_notebook_asks():
    """Noise, kind of beacon, limit and trips; the cells are not run for it."""
    command, cells = tags_notebook()
    asked: dict[str, object] = {"np": np}
    exec("from driftplan import *", asked)
    code = "\n".join(cell.source for cell in cells if cell.cell_type == "code")
    exec("\n".join(re.findall(r"^(?:noise|marker|LIMIT) = .*$|^trips = \[\n[^]]*\]$", code, re.MULTILINE)), asked)
    args = build_parser().parse_args(command.split()[1:])
    assert [replace(trip, name="") for trip in asked["trips"]] == [*load_trips(EXAMPLES / "data" / args.trips)]
    assert noise_from(args) == asked["noise"]
    assert (args.max_drift, args.redundancy, args.min_capture, args.price_per_m) == (asked["LIMIT"], 2, 0.0, 1.0)
    given = kind_from(args, cost=args.beacon_price)
    assert replace(given, name=asked["marker"].name) == asked["marker"]


@pytest.mark.slow
def test_the_command_of_the_tags_notebook_gives_that_notebooks_numbers(tmp_path):
    command, cells = tags_notebook()
    (answered,) = [cell for cell in cells if cell.cell_type == "code" and "redundancy=2" in cell.source]
    said = "".join(output.text for output in answered.outputs if output.output_type == "stream")
    shutil.copy(EXAMPLES / "data/trips.csv", tmp_path)
    asked = [sys.executable, "-m", *command.split()]
    done = subprocess.run(asked, cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    table = said.splitlines()[:4]
    assert table[2].startswith("chosen together")
    assert "\n".join(table) in done.stdout
    beacons = (tmp_path / "tags.csv").read_text().count("\n") - 1  # below the header
    assert said.splitlines()[4].startswith(f"{beacons} tags instead of")
    assert (tmp_path / "design.png").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*.py")), ids=lambda f: f.stem)
def test_scripts_run_and_leave_nothing_behind(file):
    done = subprocess.run([sys.executable, str(file)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # neither OMPL's talk nor leak reports
    assert "rms" in done.stdout
