"""Beacons in files: as GeoJSON with all there is to know, and as marks in the files of detectors and fleets.

Marks have places and directions, none has what a beacon measures: reading them takes a kind. Numbers of tags are the
digits of the beacons' ids, or else their places in the list. A frame's x axis is where its beacon faces.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import asdict, fields
from math import atan2, cos, degrees, radians, sin
from pathlib import Path
from typing import Any

from driftplan.arrays import number, positive
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.errors import MapError, naming
from driftplan.files import head, read_lines
from driftplan.world.building_map import building_marks
from driftplan.world.dxf_map import read_dxf_marks
from driftplan.world.formats import Format, Mark, format_of, own_options
from driftplan.world.geojson_map import feature_collection, read_features
from driftplan.world.plain_data import MAX_YAML_BYTES, read_yaml
from driftplan.world.route_graphs import lif_marks

_KIND = tuple(f.name for f in fields(BeaconKind))


def tags_yaml(beacons: Sequence[Beacon], *, size_m: float, frame: str = "map") -> bytes:
    """Beacons as one bundle of tags for apriltag_ros, ``size_m`` wide each; `load_beacons` reads it back.

    >>> from driftplan import BeaconKind
    >>> tag = Beacon(BeaconKind.rfid(range_m=1.5, position_std_m=0.1), x=3.0, y=4.0, id="A7")
    >>> print(tags_yaml([tag], size_m=0.2).decode().splitlines()[-1])
        - {id: 7, size: 0.2, x: 3.0, y: 4.0, z: 0.0, qw: 1.0, qx: 0.0, qy: 0.0, qz: 0.0}
    """
    size = positive("size_m", size_m)
    lines = [f"{head(frame)}standalone_tags: []", "tag_bundles:", f"- name: {frame}", "  layout:"]
    for tag, beacon in zip(tag_numbers(beacons), beacons, strict=True):
        half = radians(beacon.facing_deg or 0.0) / 2
        turned = f"qw: {_short(cos(half))}, qx: 0.0, qy: 0.0, qz: {_short(sin(half))}"
        place = f"x: {_short(beacon.x)}, y: {_short(beacon.y)}, z: 0.0, {turned}"
        lines.append(f"    - {{id: {tag}, size: {size}, {place}}}")
    return "\n".join([*lines, ""]).encode()


def fiducial_map(beacons: Sequence[Beacon]) -> bytes:
    """Beacons as the ``map.txt`` of fiducial_slam: id, x, y, z, roll, pitch, yaw in degrees, variance, observations.

    It has no place for a version or a frame: fiducial_slam warns of every line that is no tag.

    >>> from driftplan import BeaconKind
    >>> tag = Beacon(BeaconKind.rfid(range_m=1.5, position_std_m=0.1), x=3.0, y=4.0, id="A7")
    >>> fiducial_map([tag])
    b'7 3.000000 4.000000 0.000000 0.000000 0.000000 0.000000 0.010000 1\\n'
    """
    lines = []
    for tag, beacon in zip(tag_numbers(beacons), beacons, strict=True):
        variance = (beacon.kind.position_std_m or 0.0) ** 2
        place = f"{beacon.x:.6f} {beacon.y:.6f} 0.000000 0.000000 0.000000 {beacon.facing_deg or 0.0:.6f}"
        lines.append(f"{tag} {place} {variance:.6f} 1\n")
    return "".join(lines).encode()


def static_transforms(beacons: Sequence[Beacon], *, frame: str = "map") -> bytes:
    """A shell script that publishes where beacons are, as frames ``tag_ID`` in ``frame``.

    >>> from driftplan import BeaconKind
    >>> tag = Beacon(BeaconKind.rfid(range_m=1.5, position_std_m=0.1), x=3.0, y=4.0, id="A7")
    >>> static_transforms([tag]).decode().splitlines()[2][-39:]
    '--frame-id map --child-frame-id tag_7 &'
    """
    lines = [f"#!/bin/sh\n{head(frame)}".rstrip()]
    for tag, beacon in zip(tag_numbers(beacons), beacons, strict=True):
        place = f"--x {_short(beacon.x)} --y {_short(beacon.y)} --yaw {_short(radians(beacon.facing_deg or 0.0))}"
        names = f"--frame-id {frame} --child-frame-id tag_{tag}"
        lines.append(f"ros2 run tf2_ros static_transform_publisher {place} {names} &")
    return "\n".join([*lines, "wait", ""]).encode()


def tag_numbers(beacons: Sequence[Beacon]) -> list[int]:
    """The number of every beacon: the digits its id ends in, if all have some and no two the same."""
    found = [re.search(r"\d{1,9}$", beacon.id) for beacon in beacons]
    numbers = [int(match[0]) for match in found if match]
    return numbers if len({*numbers}) == len(beacons) else list(range(len(beacons)))


def read_tags_yaml(path: Path) -> list[Mark]:
    """The tags of all bundles."""
    held = read_yaml(path, MapError)
    bundles = held.get("tag_bundles") if isinstance(held, dict) else None
    listed: list[Any] = bundles if isinstance(bundles, list) else [None]
    if not all(isinstance(bundle, dict) and isinstance(bundle.get("layout"), list) for bundle in listed):
        raise MapError(f"{path}: expected tag_bundles, each with a layout; standalone tags have no places")
    tags = []
    for tag in (tag for bundle in listed for tag in bundle["layout"]):
        if not isinstance(tag, dict) or type(tag.get("id")) is not int:
            raise MapError(f"{path}: expected a tag with an id, a whole number, got {tag!r:.80}")
        with naming(f"{path}, tag {tag['id']}", MapError):
            x, y, w, z = (number(name, tag.get(name, 1.0 if name == "qw" else 0.0)) for name in ("x", "y", "qw", "qz"))
            tags.append(Mark(str(tag["id"]), x, y, degrees(2 * atan2(z, w))))
    return tags


def read_fiducial_map(path: Path) -> list[Mark]:
    """The fiducials of a ``map.txt``."""
    tags = []
    for line, text in enumerate(read_lines(path, MapError, max_bytes=MAX_YAML_BYTES), start=1):
        cells: list[Any] = text.split()
        if not cells:
            continue
        with naming(f"{path}, line {line}", MapError):
            if len(cells) < 9:
                raise ValueError(f"expected id, x, y, z, roll, pitch, yaw, variance, observations, got {text[:60]!r}")
            x, y, yaw = (number(name, float(cells[k])) for name, k in (("x", 1), ("y", 2), ("yaw", 6)))
            tags.append(Mark(str(int(cells[0])), x, y, yaw))
    return tags


def _short(value: float) -> float:
    return round(float(value), 6) + 0.0  # no minus before a zero


def beacons_geojson(beacons: Sequence[Beacon]) -> bytes:
    """Beacons as points that `load_beacons` reads back.

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
    with naming(path, MapError):
        return tuple(Beacon(kind, m.x, m.y, id=m.name, facing_deg=m.facing_deg if seen else None) for m in marks)


def marks_of(beacons: Sequence[Beacon]) -> list[Mark]:
    """Beacons without what they measure."""
    return [Mark(beacon.id, beacon.x, beacon.y, beacon.facing_deg) for beacon in beacons]


def _read_geojson(path: Path) -> tuple[Beacon, ...]:
    features = read_features(path)
    found = []
    for where, _, properties, kind, place in features:
        if kind != "Point":
            continue
        if not properties:
            raise MapError(f"{where}: expected properties such as range_m and position_std_m, got none")
        values = {"name": properties.get("kind", "beacon")} | {k: properties[k] for k in _KIND[1:] if k in properties}
        try:
            facing, name = properties.get("facing_deg"), str(properties.get("id", ""))
            found.append(Beacon(BeaconKind(**values), place.x, place.y, id=name, facing_deg=facing))
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
    Format("LIF", (".lif", ".lif.json"), lif_marks, options=("level",)),
    Format("GeoJSON", (".geojson", ".json"), _read_geojson),
    Format("DXF", (".dxf",), read_dxf_marks),
    Format("apriltag_ros", (".yaml", ".yml"), read_tags_yaml),
    Format("fiducial_slam", (".txt",), read_fiducial_map),
)
