"""MovingAI maps: which characters are ground, where the first row lies, and which line of a broken file is at fault."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from driftplan.errors import MapError
from driftplan.world.mapfiles import load_world

HEADER = "type octile\nheight 2\nwidth 3\nmap\n"


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "some.map"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_ground_grass_and_swamp_are_passable_and_nothing_else(tmp_path):
    path = write(tmp_path, "type octile\nheight 1\nwidth 7\nmap\n.GS@OTW\n")
    world = load_world(path, robot_radius=0.0)
    assert world.is_free([[i + 0.5, 0.5] for i in range(7)]).tolist() == [True] * 3 + [False] * 4


def test_the_first_row_is_the_top(tmp_path):
    world = load_world(write(tmp_path, HEADER + "..@\n...\n"), robot_radius=0.0, cell_size_m=2.0)
    assert world.bounds == (0, 0, 6, 4)
    assert world.obstacles.bounds == (4, 2, 6, 4)


@pytest.mark.parametrize(
    "text", [HEADER.replace("\n", "\r\n") + "..@\r\n...\r\n", HEADER + "..@\n...", HEADER + "..@\n...\n\n\n"]
)
def test_line_ends_of_other_systems_and_blank_lines_at_the_end_are_fine(tmp_path, text):
    assert load_world(write(tmp_path, text), robot_radius=0.0).obstacles.area == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "some.map, line 1: expected 'type octile', got nothing"),
        ("type hex\nheight 2\nwidth 3\nmap\n...\n...\n", "line 1: expected 'type octile', got b'type hex'"),
        ("type octile\nheight x\nwidth 3\nmap\n", "line 2: expected 'height N', got b'height x'"),
        ("type octile\nheight 2\nwidth -3\nmap\n", "line 3: expected 'width N', got b'width -3'"),
        ("type octile\nheight 2\nwidth 0\nmap\n", "line 3: expected 'width N'"),
        ("type octile\nheight 2\nwidth 3\n...\n...\n", "line 4: expected 'map'"),
        ("type octile\nheight 999999999\nwidth 999999999\nmap\n", "at most 150000000 cells, got 999999999 x 999999999"),
        ("type octile\nheight " + "9" * 5000 + "\nwidth 3\nmap\n", "line 2: expected 'height N'"),
        (HEADER + "...\n", "expected 2 rows of cells after the header, got 1"),
        (HEADER + "...\n...\n...\n", "expected 2 rows of cells after the header, got 3"),
        (HEADER + "...\n..\n", "some.map, line 6: expected 3 cells, got 2"),
        (HEADER + "...\n.x.\n", r"some.map, line 6, column 2: expected one of \.GS@OTW, got b'x'"),
        (HEADER.encode() + b"...\n.\xff.\n", r"line 6, column 2: .* got b'\\xff'"),
        (np.random.default_rng(0).bytes(4000), "line 1: expected 'type octile'"),
    ],
    ids=range(14),
)
def test_the_line_at_fault_is_named(tmp_path, text, message):
    with pytest.raises(MapError, match=message):
        load_world(write(tmp_path, text), robot_radius=0.3)
