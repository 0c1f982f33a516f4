"""What the README shows must run, and give the numbers it gives."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

README = Path(__file__).resolve().parents[2] / "README.md"


def test_the_readmes_python_runs_from_top_to_bottom(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.DOTALL)
    assert blocks
    for block in blocks:
        exec(compile(block, str(README), "exec"), names)
    assert names["drift"].rms.round(3).tolist() == [0.0, 0.531, 0.621]
    assert float(names["drift"].at(15.0).rms) == pytest.approx(0.195, abs=5e-4)
    assert names["route"].rms <= names["route"].shortest.rms
    assert "radius95 m" in capsys.readouterr().out


def test_the_readmes_files_exist():
    text = README.read_text()
    for link in re.findall(r"\]\((?!http)([^)]+)\)", text):
        assert (README.parent / link).exists(), link


@pytest.mark.slow
def test_the_readmes_commands_run_in_the_order_printed_in_an_empty_folder(tmp_path):
    block = next(b for b in re.findall(r"```sh\n(.*?)```", README.read_text(), flags=re.DOTALL) if "driftplan fit" in b)
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/driftplan").symlink_to(Path(sys.executable).with_name("driftplan"))
    (tmp_path / "home").mkdir()
    done = subprocess.run(
        ["bash", "-euxc", block],
        cwd=tmp_path / "home",
        env={**os.environ, "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    made = {path.name for path in (tmp_path / "home/first-hour").iterdir()}
    assert {"noise.yaml", "route.png", "tags.geojson", "layout.svg", "design.png"} <= made
    assert "Warning" not in done.stderr


@pytest.mark.slow
def test_the_sample_files_are_what_their_script_makes(tmp_path):
    """But for drawings and pages, in which libraries say their versions."""
    data = README.parent / "examples/data"
    subprocess.run([sys.executable, data / "make_data.py", tmp_path], check=True, capture_output=True)
    for folder, left_out in ((".", (".py",)), ("formats", (".dxf", ".pdf"))):
        made, there = (
            {p.name: p.read_bytes() for p in (base / folder).iterdir() if p.is_file() and p.suffix not in left_out}
            for base in (tmp_path, data)
        )
        assert made == there
