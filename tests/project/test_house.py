"""The shape of the house: imports go up the design's list only, and importing driftplan costs next to nothing."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "driftplan"
BASEMENT = ["errors", "arrays", "files", "tables", "door"]  # modules of their own, that every floor may import
FLOORS = [*BASEMENT, "model", "literature", "world", "beacons", "page", "planning", "layouts", "report"]


def floor_of(file: Path) -> str:
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


MODULES = sorted(p for p in PACKAGE.rglob("*.py") if floor_of(p) in FLOORS)


def imported(file: Path) -> list[str]:
    """Absolute dotted names of everything a module imports, wherever in the file."""
    package = ["driftplan", *file.relative_to(PACKAGE).parent.parts]
    names = []
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            names += [module] if node.module else [f"{module}.{alias.name}" for alias in node.names]
    return names


@pytest.mark.parametrize("file", MODULES, ids=lambda f: str(f.relative_to(PACKAGE)))
def test_imports_only_go_up_the_list(file):
    mine = FLOORS.index(floor_of(file))
    for name in imported(file):
        if name.startswith("driftplan."):
            floor = name.split(".")[1]
            assert floor in FLOORS[: mine + 1], f"{file.relative_to(PACKAGE)} imports {name}"


@pytest.mark.parametrize("file", MODULES, ids=lambda f: str(f.relative_to(PACKAGE)))
def test_only_the_planning_wing_imports_ompl(file):
    if floor_of(file) != "planning":
        assert not [name for name in imported(file) if name.split(".")[0] == "ompl"]


def test_no_module_is_longer_than_400_lines():
    assert [p.name for p in PACKAGE.rglob("*.py") if len(p.read_text().splitlines()) > 400] == []


def test_the_oracle_shares_no_formula_with_what_it_checks():
    names = imported(PACKAGE / "model/simulation.py")
    formulas = r"moments|elements|drift$|heading_laws|covariance|filter_state|fusion"
    assert not [name for name in names if re.search(formulas, name)]


def test_where_is_what_names_files_that_are_there():
    named = re.findall(
        r"\b[a-z_]+(?:/[a-z_]+)*\.(?:py|js|yaml)\b", ast.get_docstring(ast.parse((PACKAGE / "__init__.py").read_text()))
    )
    assert len(named) > 30
    assert [name for name in named if not (PACKAGE / name).exists()] == []


def test_every_public_name_can_be_imported():
    import driftplan

    assert [name for name in driftplan.__all__ if not hasattr(driftplan, name)] == []


def test_dir_is_short_and_holds_the_names_of_the_first_hour():
    import driftplan

    listed = driftplan.__dir__()
    assert len(listed) == len(set(listed)) < 25
    assert set(listed) <= set(driftplan.__all__)
    for page in ("README.md", "examples/guide/own-map.md"):
        blocks = re.findall(r"```python\n(.*?)```", (PACKAGE.parent / page).read_text(), re.DOTALL)
        for node in ast.walk(ast.parse("\n".join(blocks))):
            if isinstance(node, ast.ImportFrom) and node.module == "driftplan":
                assert {alias.name for alias in node.names} <= set(listed)


@pytest.mark.slow
def test_a_users_script_is_typed_strictly(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from driftplan import BeaconKind, OdometryNoise, bundled_map, load_world, place_beacons, plan_route\n"
        "noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)\n"
        "world = load_world(bundled_map('warehouse'), robot_radius=0.3)\n"
        "route = plan_route(world, (51.0, 33.0), (23.5, 18.7), noise)\n"
        "layout = place_beacons(world, [route], noise, 0.6, BeaconKind.rfid(1.5, 0.1))\n"
        "length: float = route.length\n"
        "wrong: str = layout.worst_drift\n"
    )
    asked = [sys.executable, "-m", "mypy", "--strict", "--config-file", "/dev/null", "--cache-dir", str(tmp_path)]
    done = subprocess.run([*asked, str(script)], cwd=PACKAGE.parent, capture_output=True, text=True)
    of_script = [line for line in done.stdout.splitlines() if line.startswith(str(script))]
    assert len(of_script) == 1, done.stdout  # what is wrong on purpose, and nothing else
    assert ":7:" in of_script[0]


def test_importing_driftplan_loads_nothing_heavy():
    heavy = ("ompl", "matplotlib", "scipy", "shapely", "numpy")
    code = f"import sys, driftplan; print([m for m in {heavy} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_predicting_drift_needs_neither_ompl_nor_matplotlib_nor_shapely():
    code = (
        "import sys; from driftplan import OdometryNoise, predict_drift;"
        "predict_drift([(0, 0), (1, 0)], OdometryNoise(heading_var_per_m=1e-4)).end.rms;"
        "print([m for m in ('ompl', 'matplotlib', 'scipy', 'shapely') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


@pytest.mark.parametrize("package", sorted(PACKAGE.rglob("*/__init__.py")), ids=lambda f: str(f.parent.name))
def test_every_package_says_where_everything_is(package):
    said = set(re.findall(r"\w+", ast.get_docstring(ast.parse(package.read_text())) or ""))
    there = {p.stem for p in package.parent.glob("*.py")} | {
        p.parent.name for p in package.parent.glob("*/__init__.py")
    }
    assert there - {"__init__"} <= said
