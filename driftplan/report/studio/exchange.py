"""Files that the page leaves to Python to read and to write: those of `driftplan place` beside plain text."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.beacon_files import load_beacons
from driftplan.errors import DriftplanError
from driftplan.layouts.layout import Layout
from driftplan.layouts.layout_files import InstallerRow, layout_building, layout_dxf, layout_html, layout_lif
from driftplan.page.scene import Scene, beacon_of, beacon_said
from driftplan.report.commands.answer import figure_bytes
from driftplan.report.figures.layouts import layout_figure
from driftplan.report.figures.sheet import layout_pdf
from driftplan.world.route_files import read_path

_OF_BEACONS = (".geojson", ".json", ".lif", ".dxf", ".txt", ".building.yaml")
_WRITERS: dict[str, Callable[[Layout], bytes]] = {
    "beacons.dxf": layout_dxf,
    "layout.lif": layout_lif,
    "sheet.pdf": layout_pdf,
    "table.html": layout_html,
    "layout.svg": lambda layout: figure_bytes(layout_figure(layout), "svg"),
}


def written(name: str, layout: Layout, building: tuple[Path, str | None] | None) -> bytes:
    """The file of a layout that has this name; ``building`` is the Open-RMF map and its level, None for other maps."""
    if name == "site.building.yaml" and building is not None:
        return layout_building(layout, building[0], level=building[1])
    if name not in _WRITERS:
        raise ValueError(f"expected {', '.join(_WRITERS)}, or site.building.yaml where that is the map, got {name}")
    return _WRITERS[name](layout)


def read(name: str, text: str, scene: Scene, kind: BeaconKind) -> dict[str, Any]:
    """What a file changes in a scene: its beacons, or one more route. ``kind`` is that of beacons that say none."""
    if text.startswith(",".join(InstallerRow._fields[:4])):
        return {"beacons": _as_built(text, scene, kind)}
    with TemporaryDirectory() as folder:
        file = Path(folder, Path(name).name)
        file.write_text(text, encoding="utf-8")
        try:
            if file.name.lower().endswith(_OF_BEACONS) or "tag_bundles" in text:
                return {"beacons": [*map(beacon_said, load_beacons(file, kind))]}
            points = read_path(file)[:, :2].tolist()
        except DriftplanError as err:
            raise ValueError(str(err).replace(f"{folder}/", "")) from err
    limits = [route["limit_m"] for route in scene["routes"]]
    return {"routes": [*scene["routes"], {"name": name, "points": points, "limit_m": limits[0] if limits else None}]}


def _as_built(text: str, scene: Scene, kind: BeaconKind) -> list[dict[str, Any]]:
    """Beacons of an installers' table, which says where they are: those that the scene knows, by their ids, keep what
    they are; others are of a kind of that name in the scene, or of ``kind``."""
    known = {one["id"]: one for one in scene["beacons"]}
    kinds = {one["kind"]["name"]: beacon_of(one).kind for one in scene["beacons"]}
    found = []
    for line, row in enumerate(csv.DictReader(io.StringIO(text)), start=2):
        try:
            own = known.get(row["id"])
            of_kind = kinds.get(row["kind"], kind) if own is None else beacon_of(own).kind
            facing = float(row["facing_deg"]) if row["facing_deg"] else None
            beacon = Beacon(of_kind, float(row["x_m"]), float(row["y_m"]), id=row["id"], facing_deg=facing)
        except (KeyError, TypeError, ValueError) as err:
            raise ValueError(f"line {line}: expected a row of an installers' table: {err}") from err
        kept = {key: own[key] for key in ("locked", "dead") if key in own} if own else {}
        found.append({**beacon_said(beacon, existing=row.get("new") == "False"), **kept})
    return found
