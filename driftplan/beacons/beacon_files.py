"""Beacons in files: as GeoJSON with all there is to know, and as marks in the files of detectors and fleets.

Marks have places and directions, none has what a beacon measures: reading them takes a kind.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.tag_files import read_fiducial_map, read_tags_yaml
from driftplan.errors import MapError
from driftplan.world.building_map import building_marks
from driftplan.world.dxf_map import read_dxf_marks
from driftplan.world.formats import Format, Mark, format_of, own_options
from driftplan.world.geojson_map import feature_collection, read_features
from driftplan.world.lif import read_lif

_KIND = tuple(f.name for f in fields(BeaconKind))


def beacons_geojson(beacons: Sequence[Beacon]) -> bytes:
    """Beacons as points that `load_beacons` reads back.

    Examples
    --------
    >>> import tempfile
    >>> tag = Beacon(BeaconKind.rfid(range_m=1.5, position_std_m=0.1), x=3.0, y=4.0, id="A7")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "beacons.geojson")
    ...     _ = file.write_bytes(beacons_geojson([tag]))
    ...     load_beacons(file) == (tag,)
    True
    """
    return feature_collection([beacon_feature(beacon) for beacon in beacons])


def load_beacons(
    path: str | os.PathLike[str], kind: BeaconKind | None = None, *, level: str | None = None
) -> tuple[Beacon, ...]:
    """Beacons of a GeoJSON file, as `layout_geojson` and `beacons_geojson` write it, or of files without kinds.

    Point features in metres; properties by the names of `BeaconKind` (``range_m`` and a ``position_std_m``,
    ``heading_std``, ``range_std_m`` or ``bearing_std`` at least, ``kind`` for its name), ``facing_deg`` and ``id``.
    Features that are no points are passed over, so a map and its beacons may share a file; other properties are too. A
    file without features holds no beacons.

    A ``tags.yaml`` with bundles (apriltag_ros), a ``map.txt`` (fiducial_slam), a drawing (`layout_dxf`), a layout in
    LIF (`layout_lif`) and a ``.building.yaml`` (`layout_building`) have places and directions, so they need a ``kind``;
    the last two may have a ``level``.

    Raises
    ------
    MapError : if the file cannot be read or a point is no beacon: the message names the file and the feature

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "map.txt").write_text("7 3.0 4.0 0.0 0.0 0.0 0.0 0.01 1\\n")
    ...     (tag,) = load_beacons(Path(folder, "map.txt"), BeaconKind.rfid(range_m=1.5, position_std_m=0.1))
    >>> tag.id, tag.x, tag.y, tag.kind.name
    ('7', 3.0, 4.0, 'rfid')
    """
    path = Path(path)
    form = format_of(path, FORMATS, "beacons")
    own = own_options(path, form, FORMATS, {"level": level})
    if form.name == "GeoJSON":
        return _read_geojson(path)
    if kind is None:
        raise MapError(f"{path}: {form.name} says nothing of what beacons measure: load them with a kind")
    marks: list[Mark] = form.read(path, **own)
    if not marks:
        raise MapError(f"{path}: expected tags with places, got none")
    seen = kind.view_angle_deg < 360
    return tuple(Beacon(kind, m.x, m.y, id=m.name, facing_deg=m.facing_deg if seen else None) for m in marks)


def marks_of(beacons: Sequence[Beacon]) -> list[Mark]:
    """Beacons without what they measure."""
    return [Mark(beacon.id, beacon.x, beacon.y, beacon.facing_deg) for beacon in beacons]


def _read_geojson(path: Path) -> tuple[Beacon, ...]:
    features = read_features(path)
    found = []
    for number, feature in enumerate(features, start=1):
        where = f"{path}, feature {number}"
        geometry = feature.get("geometry") if isinstance(feature, dict) else None
        if not isinstance(geometry, dict) or geometry.get("type") != "Point":
            continue
        properties = feature.get("properties")
        if not isinstance(properties, dict):
            raise MapError(f"{where}: expected properties such as range_m and position_std_m, got none")
        values = {"name": properties.get("kind", "beacon")} | {k: properties[k] for k in _KIND[1:] if k in properties}
        try:
            x, y = geometry["coordinates"][:2]
            facing, name = properties.get("facing_deg"), str(properties.get("id", ""))
            found.append(Beacon(BeaconKind(**values), x, y, id=name, facing_deg=facing))
        except (KeyError, TypeError, ValueError) as err:
            raise MapError(f"{where}: expected a beacon: {err}") from err
    if features and not found:
        raise MapError(f"{path}: expected at least one Point feature with the properties of a beacon, got none")
    return tuple(found)


def beacon_feature(beacon: Beacon, **more: Any) -> dict[str, Any]:
    """A beacon as a GeoJSON feature, with ``more`` properties."""
    kind = {name: value for name, value in asdict(beacon.kind).items() if name != "name" and value is not None}
    facing = {} if beacon.facing_deg is None else {"facing_deg": beacon.facing_deg}
    return {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": [beacon.x, beacon.y]},
        "properties": {"id": beacon.id, "kind": beacon.kind.name, **kind, **facing, **more},
    }


FORMATS = (
    Format("Open-RMF", (".building.yaml",), building_marks, options=("level",)),
    Format("LIF", (".lif", ".lif.json"), lambda path, **level: read_lif(path, **level).beacons, options=("level",)),
    Format("GeoJSON", (".geojson", ".json"), _read_geojson),
    Format("DXF", (".dxf",), read_dxf_marks),
    Format("apriltag_ros", (".yaml", ".yml"), read_tags_yaml),
    Format("fiducial_slam", (".txt",), read_fiducial_map),
)
