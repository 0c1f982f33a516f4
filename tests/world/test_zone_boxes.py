"""The boxes of zones leave out none that may be met, and few of many are looked at."""

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st

from driftplan.model.noise import OdometryNoise
from driftplan.planning.ompl.zone_lookup import ZoneLookup
from driftplan.world.world import World
from driftplan.world.zones import Zone, ZoneBoxes

WET = OdometryNoise(heading_var_per_m=1e-3)


def random_boxes(rng, count):
    """Of all sizes, some of them flat in one direction, many on a lattice, so that they share borders."""
    low = rng.uniform(-20, 20, (count, 2))
    size = rng.choice([0.1, 1.0, 10.0], (count, 1)) * rng.uniform(0, 1, (count, 2))
    boxes = np.c_[low, low + size]
    boxes[::3] = np.round(boxes[::3])
    return boxes


def overlapping(boxes, xmin, ymin, xmax, ymax):
    meets = (boxes[:, 0] <= xmax) & (boxes[:, 2] >= xmin) & (boxes[:, 1] <= ymax) & (boxes[:, 3] >= ymin)
    return np.flatnonzero(meets)[::-1].tolist()


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 5, 17, 200]), st.sampled_from([0.0, 1e6]))
@example(0, 17, 1e6)
def test_no_box_is_left_out(seed, count, offset):
    rng = np.random.default_rng(seed)
    boxes = random_boxes(rng, count) + offset
    found = ZoneBoxes(boxes)
    ends = rng.uniform(-30, 30, (40, 2, 2)) + offset
    ends[::4] = np.round(ends[::4])
    ends[1::4, 1, 0] = ends[1::4, 0, 0]  # upright,
    ends[2::4, 1, 0] = ends[2::4, 0, 0] + 1e-9  # and almost so
    for (x0, y0), (x1, y1) in ends.tolist():
        box = min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)
        assert found.on_box(*box) == overlapping(boxes, *box)
        assert found.at_point(x0, y0) == overlapping(boxes, x0, y0, x0, y0)
        near = found.on_segment(x0, y0, x1, y1)
        met = shapely.intersects(shapely.LineString([(x0, y0), (x1, y1)]), shapely.box(*boxes.T))
        assert set(np.flatnonzero(met).tolist()) <= set(near) <= set(overlapping(boxes, *box))
        assert near == sorted(near, reverse=True)
    points = ends[:, 0]
    point, box = found.at_points(points)
    pairs = set(zip(point.tolist(), box.tolist(), strict=True))
    assert len(pairs) == len(point)
    assert pairs >= {(i, k) for i, p in enumerate(points.tolist()) for k in overlapping(boxes, *p, *p)}
    assert (np.diff(box) >= 0).all()


def test_few_of_many_zones_are_looked_at():
    """What a motion costs does not grow with the number of zones elsewhere."""
    x, y = (v.ravel() for v in np.meshgrid(np.arange(100.0), np.arange(100.0)))
    found = ZoneBoxes(np.c_[x, y, x + 0.5, y + 0.5])
    assert len(found.at_point(50.2, 50.2)) == 1
    assert len(found.on_segment(50.2, 50.2, 53.2, 51.2)) <= 8
    assert len(found.on_segment(0.2, 0.2, 99.2, 99.2)) <= 300  # of 10,000


@pytest.mark.parametrize("far", [np.nan, np.inf, -np.inf, 1e300])
def test_what_is_nowhere_is_in_no_box(far):
    found = ZoneBoxes(np.array([(0.0, 0.0, 1.0, 1.0), (3.0, 3.0, 4.0, 4.0)]))
    for x, y in ((far, 0.5), (0.5, far), (far, far)):
        assert found.at_point(x, y) == found.on_segment(x, y, x, y) == found.on_box(x, y, x, y) == []


@pytest.mark.parametrize("sides", [3, 8, 100])
def test_one_motion_at_a_time_gets_the_answer_of_the_bulk(sides):
    rng = np.random.default_rng(sides)
    angle = np.sort(rng.uniform(0, 2 * np.pi, (40, sides)))
    corners = np.stack([np.cos(angle), np.sin(angle)], -1) * rng.uniform(1, 3, (40, 1, 1)) + rng.uniform(
        0, 30, (40, 1, 2)
    )
    zones = [Zone(ring, WET) for ring in corners if shapely.Polygon(ring).is_valid]
    world = World.from_polygons([], bounds=(0, 0, 30, 30), robot_radius=0.1, zones=zones)
    lookup = ZoneLookup(zones, range(len(zones)), -1)
    points = np.concatenate([rng.uniform(-1, 31, (200, 2)), corners[:, :5].reshape(-1, 2)])
    assert [lookup.at(*p) for p in points.tolist()] == world.zone_at(points).tolist()
    a, b = rng.uniform(0, 30, (2, 100, 2))
    pieces = world.zone_pieces(a, b)
    for i in range(len(a)):
        alone = list(lookup.pieces(*a[i].tolist(), *b[i].tolist()))
        middle = np.array([0.5 * (begin + end) for begin, end, _ in alone])
        mine = pieces.segment == i
        which = np.searchsorted(pieces.end[mine], middle)
        assert [zone for *_, zone in alone] == pieces.zone[mine][which].tolist()


@pytest.mark.parametrize("seed", [1, 5, 9, 13])
def test_a_motion_that_enters_by_a_corner_is_in_the_zone_behind_it(seed):
    rng = np.random.default_rng(seed)
    low, size = np.round(rng.uniform(0, 30, (25, 2))), np.round(rng.uniform(1, 6, (25, 2)))
    zones = [Zone(shapely.box(*box), WET) for box in np.c_[low, low + size].tolist()]
    world = World.from_polygons([], bounds=(0, 0, 40, 40), robot_radius=0.1, zones=zones)
    lookup = ZoneLookup(zones, range(len(zones)), -1)
    a = np.round(rng.uniform(-2, 38, (200, 2)))
    b = a + np.round(rng.uniform(1, 9, (200, 1))) * rng.choice([-1, 1], (200, 2))  # over corners of the lattice
    along = np.linspace(0.0031, 0.9967, 50)
    for begin, end in zip(a.tolist(), b.tolist(), strict=True):
        pieces = lookup.pieces(*begin, *end)
        assert [piece[0] for piece in pieces[1:]] == pytest.approx([piece[1] for piece in pieces[:-1]], abs=1e-9)
        which = np.searchsorted([piece[1] for piece in pieces], along)
        places = np.array(begin) + along[:, None] * (np.array(end) - begin)
        assert [pieces[k][2] for k in which] == world.zone_at(places).tolist()
