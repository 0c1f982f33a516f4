"""What the README shows must run, and give the numbers it gives."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

README = Path(__file__).resolve().parents[1] / "README.md"


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
