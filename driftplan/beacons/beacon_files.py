"""Beacons as GeoJSON. Coordinates are metres of the map's frame, not longitude and latitude."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.tag_files import read_tags
from driftplan.errors import MapError
from driftplan.world.geojson_map import feature_collection, read_features

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


def load_beacons(path: str | os.PathLike[str], kind: BeaconKind | None = None) -> tuple[Beacon, ...]:
    """Beacons of a GeoJSON file, as `layout_geojson` and `beacons_geojson` write it, or tags of ROS.

    Point features in metres; properties by the names of `BeaconKind` (``range_m`` and a ``position_std_m``,
    ``heading_std``, ``range_std_m`` or ``bearing_std`` at least, ``kind`` for its name), ``facing_deg`` and ``id``.
    Features that are no points are passed over, so a map and its beacons may share a file; other properties are too. A
    file without features holds no beacons. A ``tags.yaml`` with bundles (apriltag_ros) and a ``map.txt``
    (fiducial_slam) have places and no kind, so they need one.

    Raises
    ------
    MapError : if the file cannot be read or a point is no beacon: the message names the file and the feature
    """
    path = Path(path)
    if path.suffix.lower() in (".yaml", ".yml", ".txt"):
        if kind is None:
            raise MapError(f"{path}: tags say nothing of what they measure: load them with a kind, as GeoJSON has it")
        return read_tags(path, kind)
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
