"""A wheel, installed into an empty environment with the lowest versions that pyproject.toml allows, runs the demo."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ("driftplan", "maps", "examples", "pyproject.toml", "README.md", "LICENSE", "tests")


def copied(source: Path) -> Path:
    """What is built from, where building may leave its own folders."""
    source.mkdir()
    for name in SHIPPED:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, source / name, **({"symlinks": True} if copy is shutil.copytree else {}))
    return source


@pytest.mark.slow
def test_the_source_distribution_has_no_stray_files_and_makes_the_whole_wheel(tmp_path):
    source, clean = copied(tmp_path / "source"), {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    python = tmp_path / "env/bin/python"
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "env")], check=True)
    got = subprocess.run([python, "-m", "pip", "install", "-q", "setuptools>=77"], capture_output=True, env=clean)
    if got.returncode:
        pytest.skip("setuptools cannot be had here")
    build = f"import setuptools.build_meta as build; build.build_sdist({str(tmp_path)!r})"
    subprocess.run([python, "-c", build], cwd=source, check=True, capture_output=True, env=clean)
    (sdist,) = tmp_path.glob("driftplan-*.tar.gz")
    with tarfile.open(sdist) as archive:
        tops = {Path(name).parts[1] for name in archive.getnames() if len(Path(name).parts) > 1}
    own = {"driftplan", "pyproject.toml", "README.md", "LICENSE"}
    assert tops == own | {"PKG-INFO", "setup.cfg", "driftplan.egg-info"}
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(tmp_path), str(sdist)]
    subprocess.run(pip, check=True, capture_output=True, env=clean)
    (wheel,) = tmp_path.glob("driftplan-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        packed = set(archive.namelist())
    code = {str(file.relative_to(ROOT)) for file in (ROOT / "driftplan").rglob("*.py") if not file.is_symlink()}
    data = {f"driftplan/{name}" for name in ("maps/warehouse.pgm", "samples/trips.csv", "page/studio.js", "py.typed")}
    assert code | data <= packed


@pytest.mark.slow
def test_the_wheel_runs_the_demo_with_the_lowest_versions_stated(tmp_path):
    source, clean = copied(tmp_path / "source"), {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
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
