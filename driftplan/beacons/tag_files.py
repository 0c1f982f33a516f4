"""Beacons as the detectors of ROS know them: ``tags.yaml``, the map of fiducial_slam, static transforms.

Numbers of tags are the digits of the beacons' ids, or else their places in the list. A frame's x axis is where its
beacon faces.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import atan2, cos, degrees, radians, sin
from pathlib import Path
from typing import Any

from driftplan.arrays import number, positive
from driftplan.beacons.beacon import Beacon
from driftplan.errors import MapError, naming
from driftplan.files import head, read_lines
from driftplan.world.formats import Mark
from driftplan.world.plain_data import read_yaml

_MAX_BYTES = 5_000_000


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
        lines.append(
            f"    - {{id: {tag}, size: {size}, x: {_short(beacon.x)}, y: {_short(beacon.y)}, z: 0.0, {turned}}}"
        )
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
    held = read_yaml(path, MapError, max_bytes=_MAX_BYTES)
    bundles = held.get("tag_bundles") if isinstance(held, dict) else None
    if not isinstance(bundles, list) or not all(
        isinstance(b, dict) and isinstance(b.get("layout"), list) for b in bundles
    ):
        raise MapError(f"{path}: expected tag_bundles, each with a layout; standalone tags have no places")
    tags = []
    for tag in (tag for bundle in bundles for tag in bundle["layout"]):
        if not isinstance(tag, dict) or type(tag.get("id")) is not int:
            raise MapError(f"{path}: expected a tag with an id, a whole number, got {tag!r:.80}")
        with naming(f"{path}, tag {tag['id']}", MapError):
            x, y, w, z = (number(name, tag.get(name, 1.0 if name == "qw" else 0.0)) for name in ("x", "y", "qw", "qz"))
            tags.append(Mark(str(tag["id"]), x, y, degrees(2 * atan2(z, w))))
    return tags


def read_fiducial_map(path: Path) -> list[Mark]:
    """The fiducials of a ``map.txt``."""
    tags = []
    for line, text in enumerate(read_lines(path, MapError, max_bytes=_MAX_BYTES), start=1):
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
