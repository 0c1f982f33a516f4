"""A wheel, installed into an empty environment with the lowest versions that pyproject.toml allows, runs the demo."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = ("driftplan", "maps", "examples", "pyproject.toml", "README.md", "LICENSE")


@pytest.mark.slow
def test_the_wheel_runs_the_demo_with_the_lowest_versions_stated(tmp_path):
    source, clean = tmp_path / "source", {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    source.mkdir()
    for name in SHIPPED:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, source / name, **({"symlinks": True} if copy is shutil.copytree else {}))
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(tmp_path), str(source)]
    subprocess.run(pip, check=True, capture_output=True, env=clean)
    (wheel,) = tmp_path.glob("driftplan-*.whl")
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    lowest = [re.sub(r">=([\d.]+).*", r"==\1", need) for need in stated]
    env = tmp_path / "env"
    subprocess.run([sys.executable, "-m", "venv", str(env)], check=True)
    install = [str(env / "bin/pip"), "install", "--quiet", str(wheel), *lowest]
    installed = subprocess.run(install, capture_output=True, text=True, env=clean)
    if "No matching distribution" in installed.stderr or "Connection" in installed.stderr:
        pytest.skip("these versions cannot be had here")
    assert installed.returncode == 0, installed.stderr
    demo = subprocess.run(
        [str(env / "bin/driftplan"), "demo"], cwd=tmp_path, capture_output=True, text=True, timeout=300, env=clean
    )
    assert demo.returncode == 0, demo.stderr
    assert {file.name for file in (tmp_path / "driftplan-demo").iterdir()} == {
        "warehouse.png",
        "office.png",
        "warehouse-tags.png",
    }
