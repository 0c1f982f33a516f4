"""The page in a real browser: a layout that was mailed, dragged, killed, undone, exported, with Python's numbers."""

from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from driftplan import Beacon, BeaconKind, OdometryNoise, drift_with_beacons, load_beacons, load_zones, save_noise
from driftplan.beacons.beacon_files import beacons_geojson, fiducial_map, static_transforms, tags_yaml
from driftplan.layouts.layout_files import layout_csv
from driftplan.model.worst import worst_rms
from driftplan.page.scene import beacon_of, page, scene_of, script, zones_of

STUDIO = "document.getElementById('studio').studio"


@pytest.fixture
def studio(browser, layout, tmp_path):
    """The page of the layout, open; a function that gives the value of an expression about it."""
    layout.to_html(tmp_path / "layout.html")
    browser.open((tmp_path / "layout.html").as_uri())
    return lambda expression: browser.js(f"(() => {{ const studio = {STUDIO}; return {expression}; }})()")


def worst_on_page(studio):
    return studio("(studio.frame(), studio.shown.worst)")


def worst_of(layout, beacons, estimator="reset"):
    """The greatest drift of every route, by Python."""
    scenario = replace(layout.scenario, estimator=estimator)
    return [worst_rms(scenario.drift(r, beacons)) for r in range(len(layout.drifts))]


def screen(studio, xy):
    """Where a place of the map is, in pixels of the page."""
    return studio(
        f"(() => {{ const [x, y] = studio.map.toScreen({list(xy)}), box = studio.map.overlay.getBoundingClientRect();"
        " return [x + box.left, y + box.top]; })()"
    )


def test_a_tag_dragged_by_mouse_has_pythons_drift(browser, studio, layout):
    first = layout.beacons[0]
    assert worst_on_page(studio) == pytest.approx(worst_of(layout, layout.beacons), rel=1e-8)
    studio("(studio.snap = false)")
    browser.drag(screen(studio, (first.x, first.y)), screen(studio, (first.x + 1.3, first.y - 0.4)))
    x, y = studio("[studio.session.scene.beacons[0].x, studio.session.scene.beacons[0].y]")
    assert (x, y) == pytest.approx((first.x + 1.3, first.y - 0.4), abs=0.05)
    moved = (replace(first, x=x, y=y), *layout.beacons[1:])
    assert worst_on_page(studio) == pytest.approx(worst_of(layout, moved), rel=1e-8)
    inside = "studio.shown.drifts[0].s.every((border) => Math.abs(border - s) > 1e-3)"  # at readings it jumps
    curve = np.array(studio(f"studio.shown.drifts[0].curve(0.5).filter(([s]) => {inside})"))
    drift = layout.scenario.drift(0, moved)
    assert curve[:, 1] == pytest.approx(drift.at(curve[:, 0]).rms, abs=2e-5)  # what is drawn, metres
    assert studio("studio.shown.drifts[0].at(5.5).N") == pytest.approx(float(drift.at(5.5).rms) ** 2, rel=1e-9)
    browser.key("z", modifiers=2)  # one drag is one step of the history
    assert worst_on_page(studio) == pytest.approx(worst_of(layout, layout.beacons), rel=1e-8)


def test_the_panel_says_the_last_of_a_drag_that_rests(browser, studio):
    """Whoever holds a tag still, to read the number, reads that of where it is."""
    studio("(studio.session.changeBeacon(0, { x: 9, y: 9 }, 'drag'), studio.frame(), 0)")
    shown = "studio.panel.lines.map(({ cells }) => cells[2].textContent)"
    browser.until(f"(() => {{ const studio = {STUDIO}; return studio.telling === null; }})()")
    assert studio(shown) == studio("studio.shown.worst.map((worst) => worst.toFixed(3))")


def test_a_tag_is_killed_and_revived(browser, studio, layout):
    studio("studio.tools.choose('kill')")
    place = screen(studio, (layout.beacons[0].x, layout.beacons[0].y))
    browser.drag(place, place, steps=1)
    assert worst_on_page(studio) == pytest.approx(worst_of(layout, layout.beacons[1:]), rel=1e-8)
    assert "is dead" in studio("studio.status.textContent")
    assert studio("studio.highlights.length") > 0  # the limit was proven to need all of them
    browser.key("z", modifiers=2)
    assert worst_on_page(studio) == pytest.approx(worst_of(layout, layout.beacons), rel=1e-8)
    browser.key("y", modifiers=2)
    assert worst_on_page(studio) == pytest.approx(worst_of(layout, layout.beacons[1:]), rel=1e-8)


def test_the_estimator_is_switched_and_both_are_compared(browser, studio, layout):
    studio("(studio.panel.compared.click(), 0)")
    both = studio("(studio.frame(), [studio.shown.worst, studio.shown.otherWorst])")
    expected = [worst_of(layout, layout.beacons, estimator) for estimator in ("reset", "filter")]
    assert both[0] == pytest.approx(expected[0], rel=1e-8)
    assert both[1] == pytest.approx(expected[1], rel=1e-8)
    studio("(studio.estimator.value = 'filter', studio.estimator.dispatchEvent(new Event('change')))")
    assert worst_on_page(studio) == pytest.approx(expected[1], rel=1e-8)


def test_everything_is_done_by_keys(browser, studio, layout):
    count = len(layout.beacons)
    studio("(studio.map.overlay.querySelector('[data-beacon]').focus(), 0)")
    x = studio("studio.session.scene.beacons[0].x")
    for key, modifiers in (("ArrowRight", 0), ("ArrowRight", 8), ("l", 0), ("ArrowRight", 0)):  # locked: it stays
        browser.key(key, modifiers)
    assert studio("studio.session.scene.beacons[0].x") == pytest.approx(x + 1.1)
    browser.key("k")  # those who listen hear what it breaks
    assert " is dead. " in studio("studio.status.textContent")
    browser.key("k")
    browser.key("d")
    assert studio("studio.session.scene.beacons.length") == count + 1
    browser.key("Delete")
    assert studio("studio.session.scene.beacons.length") == count
    studio("(studio.map.overlay.focus(), 0)")
    for key in ("a", "ArrowUp", "Enter"):
        browser.key(key)
    assert studio("studio.session.scene.beacons.length") == count + 1
    for key in ("z", "Enter", "ArrowRight", "ArrowUp", "Enter"):
        browser.key(key)
    assert studio("studio.session.scene.zones.length") == 2
    for key in ("m", "Enter", "ArrowRight", "Enter"):
        browser.key(key)
    assert " m from " in studio("studio.status.textContent")


def worst_by_python(layout, scene):
    """The greatest drift of every route of a scene as the page holds it."""
    world = replace(layout.scenario.world, zones=zones_of(scene))
    alive = [beacon_of(one) for one in scene["beacons"] if not one.get("dead")]
    noise, estimator = OdometryNoise(**scene["noise"]), scene["estimator"]
    paths = [np.array(route["points"]) for route in scene["routes"]]
    return [worst_rms(drift_with_beacons(path, noise, alive, world, estimator=estimator)) for path in paths]


@pytest.mark.parametrize("estimator", ["reset", "filter"])
def test_whatever_is_edited_the_numbers_are_pythons(browser, studio, layout, estimator, tmp_path):
    studio("studio.tools.choose('floor')")
    browser.drag(screen(studio, (12.0, 5.0)), screen(studio, (17.0, 11.0)))
    studio("studio.tools.choose('select')")
    browser.drag(screen(studio, (18.0, 2.0)), screen(studio, (16.0, 3.0)))
    assert studio("studio.session.scene.routes[0].points[1]") == pytest.approx([16, 3], abs=0.1)
    seen = BeaconKind.landmark(range_m=5, position_std_m=0.1, heading_std=0.02, view_angle_deg=120)
    file = tmp_path / "beacons.geojson"
    file.write_bytes(beacons_geojson([*layout.beacons, Beacon(seen, 10.0, 5.0, "april", facing_deg=70.0)]))
    noise = OdometryNoise(heading_var_per_m=2e-4, heading_var_per_rad=1e-3, heading_bias_per_m=1e-3)
    save_noise(tmp_path / "noise.yaml", noise)
    (tmp_path / "route.csv").write_text("x,y\n1,11\n10,7\n19,11\n")
    for made in (file, tmp_path / "noise.yaml", tmp_path / "route.csv"):
        studio(f"studio.panel.load({json.dumps(made.name)}, {json.dumps(made.read_text())})")
    studio(f"studio.session.edit({{ estimator: '{estimator}' }})")
    slider = "studio.panel.sliders[1].input"
    studio(f"({slider}.value = 0.4, {slider}.dispatchEvent(new Event('input')))")
    scene = studio("studio.session.scene")
    assert (len(scene["routes"]), len(scene["zones"])) == (3, 2)
    assert scene["noise"]["heading_bias_per_m"] == 1e-3
    assert scene["noise"]["distance_var_per_m"] == pytest.approx(0.16**2 / 10)
    assert worst_on_page(studio) == pytest.approx(worst_by_python(layout, scene), rel=1e-8)


@pytest.mark.parametrize(("width", "dark"), [(820, True), (1000, False), (1600, True), (4000, False)])
def test_nothing_is_wider_than_its_place(browser, studio, width, dark):
    browser.open(browser.js("window.location.href"), width, 1000, dark)
    studio("(studio.session.select({ beacon: 0 }), studio.toggle(0, 'dead'), studio.panel.compared.click(), 0)")
    studio(
        "(studio.session.edit({ routes: studio.session.scene.routes.map((r) => ({ ...r, name: 'x'.repeat(80) })) }), 0)"
    )
    studio("(studio.frame(), 0)")
    wide = "[...document.querySelectorAll('body, header, aside, aside *')].filter((n) => n.scrollWidth > n.clientWidth)"
    shown = f"{wide}.filter((n) => getComputedStyle(n).display !== 'inline').map((n) => n.outerHTML.slice(0, 200))"
    assert browser.js(shown) == []


def test_a_narrow_cell_of_a_wide_window_has_one_column(browser, studio):
    browser.js("(document.body.style.width = '600px', 0)")
    browser.until(f"{STUDIO}.root.classList.contains('narrow')")
    below = "studio.panel.node.getBoundingClientRect().top >= studio.chart.node.getBoundingClientRect().bottom"
    assert studio(below)
    assert studio("studio.root.scrollWidth <= studio.root.clientWidth")
    browser.js("(document.body.style.width = '', 0)")
    browser.until(f"!{STUDIO}.root.classList.contains('narrow')")


def contrast(one, other):
    """Of two colours as a browser says them, WCAG 2."""

    def luminance(colour):
        share = np.array([float(part) for part in re.findall(r"[\d.]+", colour)[:3]]) / 255
        return np.where(share <= 0.03928, share / 12.92, ((share + 0.055) / 1.055) ** 2.4) @ (0.2126, 0.7152, 0.0722)

    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("dark", [False, True])
def test_what_is_written_stands_out(browser, studio, dark):
    browser.open(browser.js("window.location.href"), dark=dark)
    seen = (
        "(name) => { const probe = document.createElement('i'); probe.style.color = `var(--${name})`;"
        " studio.root.append(probe); return getComputedStyle(probe).color; }"
    )
    names = ["text", "paper", "card", "over", "accent", "route", "wall", "zone", "drift-high"]
    colour = dict(zip(names, studio(f"{json.dumps(names)}.map({seen})"), strict=True))
    pairs = [
        ("text", "paper"),
        ("text", "card"),
        ("over", "paper"),
        ("over", "card"),
        ("accent", "paper"),
        ("text", "zone"),
    ]
    assert [pair for pair in pairs if contrast(*map(colour.get, pair)) < 4.5] == []
    lines = [("route", "paper"), ("wall", "paper"), ("drift-high", "paper")]  # what is drawn
    assert [pair for pair in lines if contrast(*map(colour.get, pair)) < 3] == []


def test_a_finger_drags_a_tag_and_reads_the_curve(browser, studio, layout):
    first = layout.beacons[0]
    studio("(studio.snap = false)")
    for kind, place in (
        ("touchStart", (0, 0)),
        ("touchMove", (0.5, 0)),
        ("touchMove", (1.3, -0.4)),
        ("touchEnd", None),
    ):
        points = [] if place is None else [screen(studio, (first.x + place[0], first.y + place[1]))]
        touches = [{"x": x, "y": y} for x, y in points]
        browser.call("Input.dispatchTouchEvent", type=kind, touchPoints=touches)
    moved = studio("[studio.session.scene.beacons[0].x, studio.session.scene.beacons[0].y]")
    assert moved == pytest.approx((first.x + 1.3, first.y - 0.4), abs=0.05)
    box = studio("(({ left, top }) => [left, top])(studio.chart.node.getBoundingClientRect())")
    touches = [{"x": box[0] + studio("studio.chart.x(5)"), "y": box[1] + 60}]
    for kind, points in (("touchStart", touches), ("touchEnd", [])):
        browser.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)
    assert studio("studio.cursor") == pytest.approx(5, abs=0.1)


def test_the_map_follows_the_cross(browser, studio):
    studio("(studio.map.zoom(4), studio.map.overlay.focus(), 0)")
    for _ in range(20):
        browser.key("ArrowRight", modifiers=8)
    x, width = studio("[studio.map.toScreen(studio.map.cross)[0], studio.map.width]")
    assert x == pytest.approx(width)
    browser.key("m")
    browser.key("Escape")
    assert studio("studio.tools.tool") == "select"


def test_two_fingers_zoom(browser, studio):
    scale, (x, y) = studio("studio.map.scale"), screen(studio, (10.0, 6.0))
    for kind, apart in (("touchStart", 50), ("touchMove", 75), ("touchMove", 100)):
        touches = [{"x": x - apart, "y": y, "id": 0}, {"x": x + apart, "y": y, "id": 1}]
        browser.call("Input.dispatchTouchEvent", type=kind, touchPoints=touches)
    browser.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    assert studio("studio.map.scale") == pytest.approx(2 * scale, rel=0.1)
    browser.drag((x, y), (x + 40, y))  # and one finger, or the mouse, moves the map again
    assert studio("studio.map.scale") == pytest.approx(2 * scale, rel=0.1)


def test_all_that_can_be_reached_has_a_name_for_those_who_do_not_see(browser, studio):
    browser.call("Accessibility.enable")
    nodes = browser.call("Accessibility.getFullAXTree")["nodes"]
    roles = ("button", "slider", "spinbutton", "combobox", "textbox", "checkbox", "radio", "application")
    reached = [n for n in nodes if n.get("role", {}).get("value") in roles and not n["ignored"]]
    assert len(reached) > 20
    assert [n for n in reached if not n.get("name", {}).get("value", "").strip()] == []


def test_beacons_go_out_and_come_back_as_place_reads_them(browser, studio, layout, tmp_path):
    radio = Beacon(BeaconKind.range_only(range_m=9.0, range_std_m=0.2, std_per_m=0.01), 3.0, 10.0, "uwb")
    seen = BeaconKind.landmark(range_m=5, position_std_m=0.1, heading_std=0.02, view_angle_deg=120)
    beacons = (*layout.beacons, radio, Beacon(seen, 5.0, 8.0, "april", facing_deg=-90.0))
    text = json.dumps(beacons_geojson(beacons).decode())
    studio(f"studio.panel.load('tags.geojson', {text})")
    written = studio("studio.panel.written('beacons.geojson')")
    file = tmp_path / "out.geojson"
    file.write_text(written)
    assert load_beacons(file) == beacons
    studio('studio.panel.load(\'tags.geojson\', \'{"type": "FeatureCollection", "features": [{}]}\')')
    assert "expected" in studio("studio.status.textContent")  # and nothing was lost
    assert studio("studio.session.scene.beacons.length") == len(beacons)


@pytest.mark.parametrize("estimator", ["reset", "filter"])
def test_a_mailed_page_writes_for_installers_and_robots_what_place_writes(browser, layout, tmp_path, estimator):
    quoted = replace(layout.beacons[0], id='door "A", left 7')
    april = BeaconKind.landmark(range_m=5, position_std_m=0.1, heading_std=0.02, view_angle_deg=120)
    beacons = (quoted, *layout.beacons[1:], Beacon(april, 5.0, 8.0, "april 2", facing_deg=-100.0))
    far = Beacon(layout.beacons[0].kind, 19.0, 0.5, "unread 1")
    scenario = replace(layout.scenario, estimator=estimator)
    ours = replace(
        layout,
        beacons=beacons,
        existing=(far,),
        scenario=scenario,
        drifts=tuple(scenario.drift(r, (far, *beacons)) for r in range(2)),
    )
    ours.to_html(tmp_path / "layout.html")
    browser.open((tmp_path / "layout.html").as_uri())
    written = {
        name: browser.js(f"{STUDIO}.panel.written('{name}')")
        for name in ("installers.csv", "tags.yaml", "map.txt", "transforms.sh")
    }
    assert written["tags.yaml"].encode() == tags_yaml(ours.everyone, size_m=0.16)
    assert written["map.txt"].encode() == fiducial_map(ours.everyone)
    assert written["transforms.sh"].encode() == static_transforms(ours.everyone)
    found, expected = (
        [*csv.reader(io.StringIO(text))] for text in (written["installers.csv"], layout_csv(ours).decode())
    )
    assert len(found) == len(expected) == len(ours.everyone) + 1
    for row, wanted in zip(found, expected, strict=True):
        for cell, other in zip(row, wanted, strict=True):  # a wall is a micrometre off where sight is blocked
            assert cell == other or float(cell) == pytest.approx(float(other), abs=1.1e-4)


def test_floors_go_out_and_come_back_as_place_reads_them(browser, studio, layout, tmp_path):
    studio("studio.session.addZone([12, 5], [17, 11], 3)")
    file = tmp_path / "floors.geojson"
    file.write_text(studio("studio.panel.written('floors.geojson')"))
    expected = zones_of(studio("studio.session.scene"))
    for zone, wanted in zip(load_zones(file), expected, strict=True):
        assert zone.polygon.equals(wanted.polygon)
        assert zone.noise == wanted.noise
    worst = worst_on_page(studio)
    studio("studio.session.edit({ zones: [] })")
    assert worst_on_page(studio) != worst
    studio(f"studio.panel.load('floors.geojson', {json.dumps(file.read_text())})")
    assert worst_on_page(studio) == worst
    for wrong in ({"coordinates": [[[0, 0], [1, "<b>"]]]}, {"coordinates": None}):
        geometry = {"type": "Polygon", **wrong}
        feature = {"type": "Feature", "properties": {"kind": "zone", "heading_var_per_m": 1}, "geometry": geometry}
        text = json.dumps({"type": "FeatureCollection", "features": [feature]})
        studio(f"studio.panel.load('floors.geojson', {json.dumps(text)})")
        assert "expected floor 1" in studio("studio.status.textContent")
        assert worst_on_page(studio) == worst


def test_a_beacon_that_needs_a_filter_is_said_where_readings_replace(browser, studio, layout):
    x, y = layout.beacons[0].x, layout.beacons[0].y
    radio = "{ name: 'range_only', range_m: 9, range_std_m: 0.1 }"
    studio(f"(studio.session.addBeacon({{ x: {x}, y: {y}, kind: {radio} }}), studio.announce())")
    assert "needs the estimator" in studio("studio.status.textContent")
    studio("(studio.session.edit({ estimator: 'filter' }), studio.announce())")
    beacons = (*layout.beacons, Beacon(BeaconKind.range_only(range_m=9, range_std_m=0.1), x, y, "radio"))
    assert worst_on_page(studio) == pytest.approx(worst_of(layout, beacons, "filter"), rel=1e-8)


def test_a_link_brings_the_state_back(browser, studio):
    studio("(studio.session.changeBeacon(0, { x: 2.5, dead: true }), studio.link())")
    address = studio("window.location.href")
    browser.open(address)
    state = studio("studio.session.scene.beacons[0]")
    assert (state["x"], state["dead"]) == (2.5, True)


HOSTILE = "</script><img src=x onerror=\"document.title='hacked'\"><b>${document.title='hacked'}"


def test_hostile_names_are_text(browser, tmp_path):
    tag = Beacon(BeaconKind(name=HOSTILE, range_m=2.0, position_std_m=0.1), 2.0, 1.0, id=HOSTILE)
    path = np.array([[0.0, 0.0], [9.0, 0.0]])
    noise = OdometryNoise(heading_var_per_m=1e-4)
    scene = scene_of(None, [path], noise, beacons=[tag], names=[HOSTILE], title=HOSTILE, notes=[HOSTILE])
    file = tmp_path / "hostile.html"
    file.write_bytes(page(scene))
    browser.open(file.as_uri())
    browser.js(f"{STUDIO}.session.select({{ beacon: 0 }})")
    browser.js(
        f"{STUDIO}.panel.load({json.dumps(HOSTILE)} + '.geojson', {json.dumps(beacons_geojson([tag]).decode())})"
    )
    browser.js(f"{STUDIO}.frame()")
    assert browser.js("document.title") == "driftplan studio"
    assert browser.js("document.querySelectorAll('img, b').length") == 0
    assert HOSTILE in browser.js("document.body.innerText")
    assert browser.js(f"{STUDIO}.shown.worst[0]") == pytest.approx(worst_rms(drift_with_beacons(path, noise, [tag])))


def test_only_text_is_ever_put_into_the_page():
    assert not [
        word for word in ("innerHTML", "outerHTML", "insertAdjacentHTML", "eval(", "</script") if word in script()
    ]


def test_only_routes_that_a_beacon_touches_are_computed_again(browser, studio, layout):
    first = "studio.session.scene.beacons[0]"
    near = studio(f"studio.session.scene.routes.map((r) => studio.calculator.readingsOn(r, {first}).length)")
    assert sorted(map(bool, near)) == [False, True]
    again = studio(
        "(() => { studio.frame(); const before = studio.shown.drifts; studio.session.changeBeacon(0,"
        " { x: studio.session.scene.beacons[0].x + 0.01 }); studio.frame();"
        " return studio.shown.drifts.map((drift, k) => drift !== before[k]); })()"
    )
    assert again == [bool(count) for count in near]
