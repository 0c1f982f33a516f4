"""ROS maps: pixels mean what map_server says they mean, and broken files are refused by name."""

from __future__ import annotations

from math import pi
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from driftplan.errors import MapError
from driftplan.world.mapfiles import load_world, save_world
from driftplan.world.world import World

GOOD = {
    "image": "map.pgm",
    "resolution": "0.5",
    "origin": "[0.0, 0.0, 0.0]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.25",
}


def write_map(folder: Path, pixels: object = ((254, 254), (254, 0)), picture: str = "map.pgm", **changes: str) -> Path:
    """A YAML file with the keys of GOOD, changed, or left out where None; and its picture, top row first."""
    if pixels is not None:
        Image.fromarray(np.array(pixels, dtype=np.uint8)).save(folder / picture)
    keys = GOOD | {"image": picture} | changes
    path = folder / "map.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in keys.items() if value is not None))
    return path


def free_cells(path: Path, **options: bool) -> list[bool]:
    """Whether the middle of each cell is free for a point robot, the picture's rows from left to right, top first."""
    world = load_world(path, robot_radius=0.0, **options)
    width, height = round(world.bounds[2] / 0.5), round(world.bounds[3] / 0.5)
    return [
        bool(world.is_free([0.5 * (i + 0.5), 0.5 * (j + 0.5)])) for j in reversed(range(height)) for i in range(width)
    ]


# p = (255 - x)/255: 0 -> 1.0, 89 -> 0.651, 90 -> 0.647, 191 -> 0.251, 192 -> 0.247, 205 -> 0.196, 254 -> 0.004
GREYS = [[0, 89, 90, 191, 192, 205, 254, 255]]


def test_trinary_divides_by_the_two_thresholds(tmp_path):
    path = write_map(tmp_path, GREYS)
    assert free_cells(path) == [False] * 4 + [True] * 4
    assert free_cells(path, unknown_is_free=True) == [False] * 2 + [True] * 6


def test_negate_turns_the_greys_round(tmp_path):
    # p = x/255: 63 -> 0.247 free, 64 -> 0.251 unknown, 165 -> 0.647 unknown, 166 -> 0.651 occupied
    path = write_map(tmp_path, [[0, 63, 64, 165, 166, 255]], negate="1")
    assert free_cells(path) == [True, True, False, False, False, False]
    assert free_cells(path, unknown_is_free=True) == [True, True, True, True, False, False]


def test_a_value_on_a_threshold_counts_as_nav2_has_it(tmp_path):
    # (255 - 102)/255 is 0.6, (255 - 204)/255 is 0.2
    path = write_map(tmp_path, [[102, 103, 203, 204]], occupied_thresh="0.6", free_thresh="0.2")
    assert free_cells(path) == [False, False, False, True]
    assert free_cells(path, unknown_is_free=True) == [False, True, True, True]


def test_raw_pixels_are_percentages_and_unknown_above_100(tmp_path):
    path = write_map(tmp_path, [[0, 24, 25, 65, 66, 100, 101, 255]], mode="raw", negate="1")  # raw ignores negate
    assert free_cells(path) == [True, True, True, False, False, False, False, False]
    assert free_cells(path, unknown_is_free=True) == [True, True, True, False, False, False, True, True]


def test_colours_are_averaged(tmp_path):
    # (255+255+64)/3 = 191.33 -> 0.2497 free; (255+255+63)/3 = 191 -> 0.251 unknown; (255, 0, 0) -> 0.667 occupied
    path = write_map(tmp_path, [[(255, 255, 64), (255, 255, 63), (255, 0, 0)]], picture="map.png")
    assert free_cells(path) == [True, False, False]
    assert free_cells(path, unknown_is_free=True) == [True, True, False]


def test_palettes_bitmaps_and_deep_greys_are_read(tmp_path):
    grey = Image.fromarray(np.array([[254, 0]], dtype=np.uint8))
    for name, picture in {
        "palette.png": grey.convert("P"),
        "bits.png": grey.convert("1"),
        "grey_alpha.png": grey.convert("LA"),
        "bits.bmp": grey.convert("1"),
        "deep.png": Image.fromarray(np.array([[65278, 0]], dtype=np.uint16)),
    }.items():
        picture.save(tmp_path / name)
        assert free_cells(write_map(tmp_path, None, picture=name)) == [True, False], name
    (tmp_path / "plain.pgm").write_text("P2\n# a comment\n2 1\n255\n254 0\n")
    assert free_cells(write_map(tmp_path, None, picture="plain.pgm")) == [True, False]


def test_scale_is_rounded_to_percent_of_the_way_between_the_thresholds(tmp_path):
    # 191 -> 0.24 %: 0, free; 188 -> 3.2 %; 90 -> 99.3 %: unknown
    path = write_map(tmp_path, [[0, 89, 90, 188, 191, 205]], mode="scale")
    assert free_cells(path) == [False] * 4 + [True] * 2
    assert free_cells(path, unknown_is_free=True) == [False] * 2 + [True] * 4


def test_the_percent_are_of_the_way_between_the_thresholds_and_of_nothing_else(tmp_path):
    # 190 -> 0.2549: 0.98 % of the way from 0.251 to 0.65, one percent, unknown
    path = write_map(tmp_path, [[190]], mode="scale", free_thresh="0.251")
    assert free_cells(path) == [False]


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_what_is_not_opaque_is_unknown_in_every_mode(tmp_path, mode):
    """Alpha is no colour either: the mean is that of the three others."""
    light = 10 if mode == "raw" else 254
    middle = (50, 50, 50, 255) if mode == "raw" else (255, 255, 43, 255)  # unknown; light, if alpha counted as a colour
    pixels = [[(light,) * 3 + (255,), (light,) * 3 + (254,), (light,) * 3 + (0,), middle]]
    path = write_map(tmp_path, pixels, picture="map.png", mode=mode)
    assert free_cells(path) == [True, False, False, False]
    assert free_cells(path, unknown_is_free=True) == [True, True, True, True]
    grey = Image.fromarray(np.array([[(light, 255), (light, 254), (light, 0)]], dtype=np.uint8), mode="LA")
    palette = Image.fromarray(np.array([[0, 1, 2]], dtype=np.uint8), mode="P")
    palette.putpalette([light] * 9)
    grey.save(tmp_path / "grey.png")
    palette.save(tmp_path / "palette.png", transparency=bytes([255, 254, 0]))
    plain = Image.fromarray(np.full((1, 3), light, dtype=np.uint8))
    plain.save(tmp_path / "key.png", transparency=light)  # one grey is transparent
    for name, free in (
        ("grey.png", [True, False, False]),
        ("palette.png", [True, False, False]),
        ("key.png", 3 * [False]),
    ):
        path = write_map(tmp_path, None, picture=name, mode=mode)
        assert free_cells(path) == free, name
        assert free_cells(path, unknown_is_free=True) == 3 * [True], name


def test_deep_greys_are_those_of_eight_bits(tmp_path):
    Image.fromarray(np.array([[257 * 254, 257 * 150, 0]], dtype=np.uint16)).save(tmp_path / "deep.png")
    path = write_map(tmp_path, None, picture="deep.png")
    assert free_cells(path) == [True, False, False]
    assert free_cells(path, unknown_is_free=True) == [True, True, False]


@pytest.mark.parametrize(
    ("pixels", "changes", "noted"),
    [
        ([[205, 254]], {}, True),
        ([[205, 254]], {"mode": "scale"}, True),
        ([[254, 0]], {}, False),
        ([[205, 254]], {"free_thresh": "0.19"}, False),  # there it is unknown
        ([[(205, 205, 205)]], {"picture": "map.png"}, False),  # savers write greys
        ([[10, 205]], {"mode": "raw"}, False),
    ],
)
def test_the_grey_that_savers_write_for_unknown_is_said_to_be_free_where_it_is(tmp_path, pixels, changes, noted):
    world = load_world(write_map(tmp_path, pixels, **changes), robot_radius=0.1)
    assert any("grey 205" in note for note in world.notes) == noted


def test_a_map_is_saved_in_the_greys_and_the_order_of_map_saver(tmp_path):
    world = World.from_polygons([[(1, 0), (1.5, 0), (1.5, 0.5), (1, 0.5)]], bounds=(0, 0, 1.5, 1), robot_radius=0.1)
    save_world(world, tmp_path / "map.yaml", cell_size_m=0.5)
    assert (tmp_path / "map.pgm").read_bytes() == b"P5\n3 2\n255\n" + bytes([254, 254, 254, 254, 254, 0])


def test_a_picture_that_was_elsewhere_is_looked_for_beside_the_map_and_that_is_said(tmp_path):
    path = write_map(tmp_path)
    path.write_text(path.read_text().replace("image: map.pgm", "image: /home/somebody/maps/map.pgm"))
    world = load_world(path, robot_radius=0.0)
    assert any("is not here; map.pgm beside the map is taken" in note for note in world.notes)


def test_a_marked_cell_is_where_origin_and_yaw_put_it(tmp_path):
    # Cell (2, 0) of 3 x 2, in the lower right, occupied. Its middle is (1.25, 0.25) from the origin's corner, along
    # the map's axes; turned by 90° that is (-0.25, 1.25); shifted by (10, -5): (9.75, -3.75).
    pixels = [[254, 254, 254], [254, 254, 0]]
    path = write_map(tmp_path, pixels, origin=f"[10.0, -5.0, {pi / 2!r}]")
    world = load_world(path, robot_radius=0.0)
    assert world.bounds == pytest.approx((9.0, -5.0, 10.0, -3.5))
    assert world.is_free([[9.75, -3.75], [9.25, -3.75], [9.75, -4.75]]).tolist() == [False, True, True]
    turned = load_world(write_map(tmp_path, pixels, origin=f"[10.0, -5.0, {pi / 6!r}]"), robot_radius=0.0)
    c, s = np.cos(pi / 6), np.sin(pi / 6)
    middles = [
        (10 + c * 0.5 * (i + 0.5) - s * 0.5 * (j + 0.5), -5 + s * 0.5 * (i + 0.5) + c * 0.5 * (j + 0.5))
        for j in (0, 1)
        for i in (0, 1, 2)
    ]
    assert turned.is_free(middles).tolist() == [True, True, False, True, True, True]
    assert not turned.is_free([10.0 - 0.1, -5.0])  # in the bounds, but beside the turned map


def test_numbers_that_yaml_takes_for_words_are_numbers(tmp_path):
    assert load_world(write_map(tmp_path, resolution="5e-1"), robot_radius=0.0).bounds == (0, 0, 1, 1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"resolution": None}, "map.yaml: the key 'resolution' is missing"),
        ({"image": None}, "map.yaml: the key 'image' is missing"),
        ({"resolution": ".nan"}, "map.yaml: expected resolution finite, got nan"),
        ({"resolution": "0"}, "expected resolution > 0 m per cell, 1e-06 at least, got 0.0"),
        ({"resolution": "-0.05"}, "expected resolution > 0"),
        ({"resolution": "fine"}, "expected resolution to be a number, got 'fine'"),
        ({"resolution": "true"}, "expected resolution to be a number, got True"),
        ({"resolution": "1" + "0" * 400}, "expected resolution finite, got inf"),
        ({"origin": "[0, 0]"}, r"expected origin to be \[x, y, yaw\], got \[0, 0\]"),
        ({"origin": "[0, 0, .inf]"}, "expected origin finite, got inf"),
        ({"occupied_thresh": "0.2"}, "expected 0 <= free_thresh < occupied_thresh <= 1, got 0.25 and 0.2"),
        ({"occupied_thresh": "1.5"}, "expected 0 <= free_thresh < occupied_thresh <= 1"),
        ({"negate": "2"}, "expected negate to be 0 or 1, got 2"),
        ({"negate": "[1]"}, r"expected negate to be 0 or 1, got \[1\]"),
        ({"mode": "binary"}, "expected mode to be one of trinary, scale, raw, got 'binary'"),
        ({"mode": "[trinary]"}, "expected mode to be one of"),
        ({"image": "../secret.pgm"}, "image '../secret.pgm' lies outside the map's folder"),
        ({"image": "/etc/passwd"}, "image '/etc/passwd' lies outside the map's folder"),
        ({"image": "gone.pgm"}, "image 'gone.pgm' is not a file"),
        ({"image": "."}, r"image '\.' is not a file"),
        ({"image": '"a\\0b"'}, "expected image to be a file name"),
        ({"image": "[a, b]"}, "expected image to be a file name"),
        (
            {"image": "!!python/object/apply:os.system ['true']"},
            "line 1: not plain YAML: could not determine a constructor",
        ),
        ({"image": "{a: " * 2_000}, "not plain YAML"),
        ({"image": '"' + "x" * 70_000 + '"'}, "at most 8192 bytes"),
        ({"image": "{a: b, c"}, "line 2: not plain YAML"),
    ],
)
def test_a_bad_key_is_named(tmp_path, changes, message):
    (tmp_path / "maps").mkdir()
    (tmp_path / "secret.pgm").write_bytes(b"P5\n1 1\n255\n\0")
    with pytest.raises(MapError, match=message):
        load_world(write_map(tmp_path / "maps", **changes), robot_radius=0.3)


@pytest.mark.parametrize("text", ["", "just words", "- a\n- b\n", "\x00\x01\x02", "é: \x80"])
def test_what_is_no_table_of_keys_is_refused(tmp_path, text):
    path = tmp_path / "map.yaml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(MapError, match=r"map.yaml.*(expected the keys|not plain YAML)"):
        load_world(path, robot_radius=0.3)


def test_a_small_yaml_that_unfolds_to_a_giant_is_refused_at_once(tmp_path):
    laughs = "a: &a [x, x, x, x, x, x, x, x, x]\n"
    for name, inner in zip("bcdefghij", "abcdefghi", strict=True):
        laughs += f"{name}: &{name} [{', '.join(['*' + inner] * 9)}]\n"
    path = tmp_path / "map.yaml"
    path.write_text(laughs + "image: *j\nresolution: *j\norigin: *j\nnegate: 0\noccupied_thresh: 1\nfree_thresh: 0\n")
    with pytest.raises(MapError, match=r"line 2: .*aliases have no place"):
        load_world(path, robot_radius=0.3)


def test_merged_keys_cannot_multiply(tmp_path):
    layers = "a0: &a0 {x: 1}\n" + "".join(
        f"a{k}: &a{k} {{<<: [{', '.join([f'*a{k - 1}'] * 10)}]}}\n" for k in range(1, 10)
    )
    path = tmp_path / "map.yaml"
    path.write_text(layers)
    with pytest.raises(MapError, match="aliases have no place"):
        load_world(path, robot_radius=0.3)


def png_of_claimed_size(width: int, height: int) -> bytes:
    import struct
    import zlib

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 100)) + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not a readable PGM, PNG or BMP picture"),
        (b"P5\n4 4\n255\n\0\0\0", "not a readable"),
        (b"P5\n4", "not a readable"),
        (b"P5\n1000000 1000000\n255\n", "at most 25000000 pixels, got far more"),
        (
            b"P5\n10000 10000\n255\n",
            "at most 25000000 cells, got 10000 x 10000: coarsen=2 \\(--coarsen 2\\) takes 2 x 2 of them for one",
        ),
        (b"P5\n0 5\n255\n", "map.pgm"),
        (b"P5\n-4 -4\n255\n" + b"\0" * 16, "map.pgm"),
        (b"P5\n2 2\n99999999\n\0\0\0\0", "not a readable"),
        (b"P2\n2 2\n255\n1 2 x 4\n", "not a readable"),
        (png_of_claimed_size(100_000, 100_000), "at most 25000000 pixels, got far more"),
        (png_of_claimed_size(4000, 4000), "not a readable"),
        (b"\x89PNG\r\n\x1a\n" + b"\xff" * 200, "not a readable"),
        (b"GIF89a" + b"\0" * 50, "not a readable"),
        (np.random.default_rng(0).bytes(5000), "not a readable"),
    ],
    ids=range(14),
)
def test_a_broken_picture_is_named(tmp_path, content, message):
    (tmp_path / "map.pgm").write_bytes(content)
    with pytest.raises(MapError, match=message) as caught:
        load_world(write_map(tmp_path, None), robot_radius=0.3)
    assert "map.pgm" in str(caught.value)


def test_a_picture_of_noise_is_refused(tmp_path):
    pixels = np.random.default_rng(0).choice([0, 254], (600, 600))
    with pytest.raises(MapError, match=r"map\.pgm: .* this looks like noise"):
        load_world(write_map(tmp_path, pixels), robot_radius=0.3)


def test_a_linked_map_finds_its_picture_beside_the_original(tmp_path):
    (tmp_path / "source").mkdir()
    (tmp_path / "installed").mkdir()
    original = write_map(tmp_path / "source")
    for name in ("map.yaml", "map.pgm"):
        (tmp_path / "installed" / name).symlink_to(original.with_name(name))
    assert load_world(tmp_path / "installed/map.yaml", robot_radius=0.0).obstacles.area == 0.25
    (tmp_path / "installed/map.pgm").unlink()
    (tmp_path / "secret.pgm").write_bytes(b"P5\n1 1\n255\n\0")
    (tmp_path / "installed/map.pgm").symlink_to(tmp_path / "secret.pgm")
    with pytest.raises(MapError, match="outside the map's folder"):
        load_world(tmp_path / "installed/map.yaml", robot_radius=0.0)
