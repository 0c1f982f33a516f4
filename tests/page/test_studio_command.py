"""`driftplan studio`: the page with Python behind it, for this machine and this page only."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from dataclasses import replace

import numpy as np
import pytest

from driftplan import Beacon, BeaconKind, Fix, InfeasibleError, drift_with_beacons, load_beacons, place_beacons
from driftplan.beacons.beacon_files import beacons_geojson, fiducial_map, tags_yaml
from driftplan.layouts.layout_files import InstallerRow, layout_building, layout_csv, layout_lif
from driftplan.page.scene import beacon_said, scene_of, script
from driftplan.report.cli import main
from driftplan.report.studio import Answers, StudioServer

STUDIO = "document.getElementById('studio').studio"


@pytest.fixture
def scene(layout):
    scenario = layout.scenario
    return scene_of(scenario.world, scenario.routes, scenario.noise, limits=layout.max_drift)


@pytest.fixture
def server(layout, scene, tmp_path):
    answers = Answers(world=layout.scenario.world, time_limit=20, save=tmp_path / "saved.geojson")
    with StudioServer(scene, answers) as one:
        thread = threading.Thread(target=one.serve_forever)
        thread.start()
        yield one
        one.shutdown()
        thread.join()


def ask(server, what, question, **headers):
    """The lines of an answer."""
    headers = {"Content-Type": "application/json", **headers}
    request = urllib.request.Request(f"{server.url}ask/{what}", json.dumps(question).encode(), headers)
    with urllib.request.urlopen(request, timeout=60) as answer:
        return [json.loads(line) for line in answer]


TAG = {"name": "rfid", "range_m": 1.5, "position_std_m": 0.1}


def test_the_fewest_are_those_of_place_beacons(server, scene, layout):
    *news, last = ask(server, "fewest", {"scene": scene, "kind": TAG})
    limits, scenario = list(layout.max_drift), layout.scenario
    expected = place_beacons(scenario.world, scenario.routes, scenario.noise, limits, BeaconKind(**TAG), time_limit=20)
    assert len(last["answer"]["beacons"]) == len(expected.beacons)
    assert last["answer"]["proven"] == expected.proven
    assert all(set(line["progress"]) == {"cost", "bound"} for line in news)


def test_what_is_infeasible_is_said_with_its_stretch(server, scene, layout):
    weak = {**TAG, "position_std_m": 5.0}
    (*_, last) = ask(server, "fewest", {"scene": scene, "kind": weak})
    scenario = layout.scenario
    with pytest.raises(InfeasibleError) as said:
        place_beacons(scenario.world, scenario.routes, scenario.noise, 0.6, BeaconKind(**weak), time_limit=20)
    assert last["answer"] == {"infeasible": str(said.value), **said.value.stretch._asdict()}


def test_why_not_is_answered_without_a_search(server, scene):
    (*_, last) = ask(server, "why", {"scene": scene, "kind": TAG})
    assert "can be kept" in last["answer"]["message"]
    (*_, last) = ask(server, "why", {"scene": scene, "kind": {**TAG, "position_std_m": 5.0}})
    assert 0 <= last["answer"]["from_m"] < last["answer"]["to_m"]


def written(server, scene, name):
    (line,) = ask(server, "write", {"scene": scene, "name": name})
    return line["answer"]["bytes"].encode("latin-1") if "answer" in line else line["error"]


def test_python_writes_what_place_writes(server, layout):
    scenario = layout.scenario
    scene = scene_of(scenario.world, scenario.routes, scenario.noise, beacons=layout.beacons, limits=layout.max_drift)
    made, ours = (json.loads(text) for text in (written(server, scene, "layout.lif"), layout_lif(layout)))
    assert made["layouts"] == ours["layouts"]  # the rest says when it was made
    assert written(server, scene, "sheet.pdf").startswith(b"%PDF")
    assert written(server, scene, "layout.svg").startswith(b"<?xml")
    for name in ("table.html", "layout.svg"):
        assert all(beacon.id.encode() in written(server, scene, name) for beacon in layout.beacons)
    assert "where that is the map" in written(server, scene, "site.building.yaml")
    assert "expected beacons.dxf" in written(server, scene, "../../etc/passwd")


def test_the_page_saves_what_python_wrote(browser, server):
    browser.open(server.url)
    browser.js("(URL.createObjectURL = (blob) => { window.kept = blob; return '#'; }, 0)")
    choice = "document.querySelector('[aria-label=\"file to write\"]')"
    browser.js(f"({choice}.value = 'sheet.pdf', {choice}.nextElementSibling.click(), 0)")
    browser.until("window.kept")
    found = browser.js("kept.bytes().then((bytes) => Array.from(bytes.slice(0, 5)))")
    assert bytes(found) == b"%PDF-"


def test_python_draws_for_installers(server, layout):
    pytest.importorskip("ezdxf")
    scenario = layout.scenario
    scene = scene_of(scenario.world, scenario.routes, scenario.noise, beacons=layout.beacons, limits=layout.max_drift)
    assert all(beacon.id.encode() in written(server, scene, "beacons.dxf") for beacon in layout.beacons)


def test_a_building_comes_back_with_what_was_placed(layout, scene, tmp_path):
    site = tmp_path / "site.building.yaml"
    site.write_text(
        "levels: {L1: {vertices: [[0, 0, 0, a], [20, 0, 0, b]], measurements: [[0, 1, {distance: [3, 20.0]}]]}}"
    )
    answers = Answers(world=layout.scenario.world, building=(site, None))
    question = {"scene": {**scene, "beacons": [*map(beacon_said, layout.beacons)]}, "name": "site.building.yaml"}
    text = answers.answer("write", question, print)["answer"]["bytes"]
    assert text.encode("latin-1") == layout_building(layout, site)
    found = answers.answer("read", {**question, "text": text, "kind": TAG}, print)["answer"]["beacons"]
    assert [one["id"] for one in found] == [beacon.id for beacon in layout.beacons]


def test_a_sheet_does_not_claim_a_limit_that_is_broken(server, scene):
    """With no tag left the routes are not under 0.6 m, and no drawing says so."""
    text = written(server, scene, "layout.svg").decode()
    assert "under 0.6 m" not in text
    assert "keep 2 routes under" in text


def test_the_fewest_are_of_the_candidates_that_were_opened(browser, server, layout, tmp_path):
    browser.open(server.url)
    browser.js(f"({STUDIO}.panel.asSites.checked = true, 0)")
    near = [[x + 0.37, y + 0.41] for x in range(1, 19) for y in range(1, 11)]
    table = "x,y\n" + "\n".join(f"{x},{y}" for x, y in near)
    browser.js(f"{STUDIO}.panel.load('sites.csv', {json.dumps(table)})")
    browser.js(f"{STUDIO}.fewest()")
    places = browser.js(f"{STUDIO}.session.scene.beacons.map(({{ x, y }}) => [x, y])")
    assert places
    assert all(place in near for place in places)
    own = [Beacon(BeaconKind.rfid(range_m=2.0, position_std_m=0.05), x, y, f"own{k}") for k, (x, y) in enumerate(near)]
    browser.js(f"{STUDIO}.panel.load('sites.geojson', {json.dumps(beacons_geojson(own).decode())})")
    browser.js(f"{STUDIO}.fewest()")
    found = browser.js(f"{STUDIO}.session.scene.beacons.map(({{ id, kind }}) => [id, kind.range_m])")
    assert found
    assert {tuple(one) for one in found} <= {(beacon.id, 2.0) for beacon in own}
    browser.js(f"{STUDIO}.session.edit({{ sites: [] }})")
    browser.js(f"{STUDIO}.fewest()")
    assert not any(place in near for place in browser.js(f"{STUDIO}.session.scene.beacons.map(({{ x, y }}) => [x, y])"))


def test_an_installers_table_moves_what_it_knows_and_adds_what_it_names(layout, scene):
    answers = Answers(world=layout.scenario.world)
    first = layout.beacons[0]
    seen = {"name": "landmark", "range_m": 4.0, "position_std_m": 0.05, "heading_std": 0.02}
    scene = {
        **scene,
        "beacons": [{**beacon_said(first), "locked": True}, beacon_said(Beacon(BeaconKind(**seen), 1, 1, "L"))],
    }
    rows = [f"{first.id},rfid,2.5,3.5,,True,,,,,,", "new1,landmark,4,5,90,False,,,,,,", "new2,unheard,1,2,,True,,,,,,"]
    question = {"scene": scene, "name": "as built.csv", "text": "\n".join([",".join(InstallerRow._fields), *rows])}
    found = answers.answer("read", {**question, "kind": TAG}, print)["answer"]["beacons"]
    assert [(one["id"], one["x"], one["kind"]["name"], one["existing"]) for one in found] == [
        (first.id, 2.5, first.kind.name, False),
        ("new1", 4.0, "landmark", True),
        ("new2", 1.0, "rfid", False),
    ]
    assert (found[0]["locked"], found[1]["facing_deg"]) == (True, 90.0)
    question["text"] += "\nnew3,rfid,far,2,,True,,,,,,"
    assert (
        "line 5: expected a row of an installers' table"
        in answers.answer("read", {**question, "kind": TAG}, print)["error"]
    )


def test_all_that_place_writes_comes_back(browser, server, layout):
    browser.open(server.url)
    scenario = layout.scenario
    scene = scene_of(scenario.world, scenario.routes, scenario.noise, beacons=layout.beacons, limits=layout.max_drift)
    browser.js(f"({STUDIO}.session.edit({{ beacons: {json.dumps(scene['beacons'])} }}), 0)")
    written = {
        "installers.csv": layout_csv(layout),
        "map.txt": fiducial_map(layout.beacons),
        "tags.yaml": tags_yaml(layout.beacons, size_m=0.2),
        "layout.lif": layout_lif(layout),
    }
    for name, content in written.items():
        text = json.dumps(content.decode())
        browser.js(f"{STUDIO}.panel.load({json.dumps(name)}, {text})")
        assert browser.js(f"{STUDIO}.status.textContent") == f"read {name}"
        places = browser.js(f"{STUDIO}.session.scene.beacons.map(({{ x, y }}) => [x, y])")
        expected = [[beacon.x, beacon.y] for beacon in layout.beacons]
        assert np.array(sorted(places)) == pytest.approx(np.array(sorted(expected)), abs=1e-4)
    browser.js(f"{STUDIO}.panel.load('poses.csv', 'x [mm],y [mm]\\n1000,2000\\n5000,2000\\n')")
    assert browser.js(f"{STUDIO}.session.scene.routes.at(-1).points") == [[1, 2], [5, 2]]  # metres, not 1000 of them
    browser.js(f"{STUDIO}.panel.load('nonsense.csv', 'what,is\\nthis,file')")
    assert browser.js(f"{STUDIO}.status.textContent").startswith("nonsense.csv")  # not where the server kept it


def test_the_page_asks_and_shows_the_answers(browser, server, layout, tmp_path):
    browser.open(server.url)
    browser.js(f"{STUDIO}.fewest()")
    assert "Proven fewest" in browser.js(f"{STUDIO}.status.textContent")
    found = browser.js(f"({STUDIO}.frame(), {STUDIO}.shown.worst)")
    assert max(found) <= 0.6 * (1 + 1e-6)
    browser.js(f"{STUDIO}.ask('save', {{}}, ({{ message }}) => {STUDIO}.say(message))")
    assert "wrote" in browser.js(f"{STUDIO}.status.textContent")
    assert len(load_beacons(tmp_path / "saved.geojson")) == browser.js(f"{STUDIO}.session.scene.beacons.length")
    browser.js(f"{STUDIO}.plan([1, 1], [18, 11])")
    assert browser.js(f"{STUDIO}.session.scene.routes.map(({{ name }}) => name)")[2:] == ["least drift", "shortest"]
    browser.js(f"{STUDIO}.session.edit({{ routes: {STUDIO}.session.scene.routes.slice(0, 2), beacons: [] }})")
    browser.js(f"({STUDIO}.kind = {{ ...{STUDIO}.kind, position_std_m: 5 }}, {STUDIO}.frame(), {STUDIO}.fewest())")
    assert "Infeasible" in browser.js(f"{STUDIO}.status.textContent")
    assert browser.js(f"{STUDIO}.highlights.length") == 1


def test_a_plan_is_there_at_once_and_a_better_one_takes_its_place(browser, server, layout):
    scenario = layout.scenario
    scene = scene_of(scenario.world, scenario.routes, scenario.noise)
    first, last = ask(server, "plan", {"scene": scene, "start": [1, 1], "goal": [18, 11]})
    soon, done = first["progress"]["routes"][0], last["answer"]["routes"][0]
    assert done["rms_m"] <= soon["rms_m"] * (1 + 1e-9)
    browser.open(server.url)
    browser.js(f"{STUDIO}.plan([1, 1], [18, 11])")
    assert browser.js(f"{STUDIO}.session.scene.routes.length") == 4
    assert browser.js(f"{STUDIO}.session.scene.routes[2].points") == done["points"]
    browser.js(f"{STUDIO}.session.undo()")  # both answers are one step of the history
    assert browser.js(f"{STUDIO}.session.scene.routes.length") == 2


def test_a_plan_starts_as_unsure_as_the_robot(layout, scene):
    """What is said of a planned route is what the page then computes for it."""
    answers, fix = Answers(world=layout.scenario.world), Fix.full(0.0, position_std_m=0.4, heading_std=0.05)
    start = {"position_cov": fix.position_cov.tolist(), "heading_std": fix.heading_std, "detection_probability": 1.0}
    for beacons in ((), layout.beacons):
        asked = {"scene": {**scene, "start_fix": start, "beacons": [*map(beacon_said, beacons)]}}
        found = answers.answer("plan", {**asked, "start": [1, 1], "goal": [18, 11]}, print)["answer"]["routes"][0]
        scenario = layout.scenario
        drift = drift_with_beacons(found["points"], scenario.noise, beacons, scenario.world, fixes=[fix])
        assert found["rms_m"] == pytest.approx(float(drift.end.rms), rel=1e-9)


@pytest.mark.parametrize("what", ["fewest", "plan", "save", "../../etc/passwd", "eval"])
def test_questions_that_make_no_sense_are_refused_in_words(server, what):
    for question in ({}, [], {"scene": {"noise": {"heading_var_per_m": -1}}}, {"scene": None}):
        (line,) = ask(server, what, question)
        assert line["error"]


def status_of(url, data=None, **headers):
    try:
        with urllib.request.urlopen(urllib.request.Request(url, data, headers), timeout=20) as answer:
            return answer.status
    except urllib.error.HTTPError as err:
        return err.code


def test_nobody_else_gets_anything(server):
    host = f"http://127.0.0.1:{server.server_port}"
    assert status_of(server.url) == 200
    for path in ("/", "/index.html", "/wrong-token/", f"{server.root}../", f"{server.root}scene.py", "//etc/passwd"):
        assert status_of(host + path) == 404
    assert status_of(server.url, Host="evil.example") == 404  # a name that someone else points to this machine
    assert status_of(f"{server.url}ask/save", b"{}", **{"Content-Type": "text/plain"}) == 404  # a form of another page
    assert status_of(f"{host}/ask/save", b"{}", **{"Content-Type": "application/json"}) == 404
    assert server.server_address[0] == "127.0.0.1"


def test_nothing_is_written_unless_a_file_was_named(layout, scene):
    answers = replace(Answers(world=layout.scenario.world), save=None)
    assert "error" in answers.answer("save", {"scene": scene}, print)


def test_the_command_writes_the_page(tmp_path, capsys):
    route = tmp_path / "route <b>.csv"
    route.write_text("x,y\n3,3\n10,3\n")
    out = tmp_path / "page.html"
    assert main(["studio", "warehouse", str(route), "--max-drift", "0.5", "--html", str(out)]) == 0
    text = out.read_text()
    assert "<!doctype html>" in text
    assert "route \\u003cb>.csv" in text
    assert main(["studio", "warehouse", str(route), "--beacons", str(tmp_path / "no.geojson")]) == 2


NOTEBOOK = """(async () => {
  const code = new Blob([CODE], { type: "text/javascript" });
  const { default: { render } } = await import(URL.createObjectURL(code));
  const scene = SCENE, heard = [];
  const model = { get: () => scene, set: (name, value) => heard.push(value), save_changes: () => heard.push("saved"),
    on: (name, listen) => { model.answer = listen; },
    send: ({ id, what, question }) => { if (what === "stop") return (model.told = id);
      if (question.goal?.[0] === 3) return null;  // Python is busy
      model.answer({ id, progress: what === "plan" ? { routes: [] } : { cost: 4, bound: 2 } });
      const answer = { beacons: [], proven: true, message: "none" };
      model.answer(what === "fewest" ? { id, answer } : { id, error: "no" }); } };
  render({ model, el: document.body });
  const { studio } = document.querySelector(".driftplan-studio");
  const { overlay } = studio.map;  // JupyterLab looks at what has the focus: its shortcuts are off there
  overlay.dispatchEvent(new FocusEvent("focusin", { bubbles: true }));
  const own = overlay.hasAttribute("data-lm-suppress-shortcuts");
  studio.map.resize();
  studio.frame();
  await studio.fewest();
  const fewest = studio.status.textContent;
  await studio.plan([1, 1], [2, 2]);
  const plan = studio.status.textContent, slow = studio.plan([1, 1], [3, 3]);
  studio.stopper.abort();
  await slow;
  model.answer({ id: model.told, progress: { cost: 4, bound: 2 } });  // was on its way: nobody hears it
  const said = studio.status.textContent;
  studio.session.addBeacon({ x: 1, y: 2, kind: studio.kind });
  for (const x of [3, 4, 5]) studio.session.changeBeacon(0, { x }, "drag");
  studio.session.settle();
  return { own, fewest, plan, stopped: model.told, said, saved: heard.at(-1), x: heard.at(-2).beacons[0].x };
})()"""


def test_a_notebook_shows_it_and_hears_of_edits(browser, layout, scene):
    browser.open_blank()
    code = NOTEBOOK.replace("CODE", json.dumps(f"{script()}\nexport default {{ render }};"))
    assert browser.js(code.replace("SCENE", json.dumps(scene))) == {
        "fewest": "★ Proven fewest: none",
        "own": True,
        "plan": "no",
        "stopped": 2,
        "said": "Stopped.",
        "saved": "saved",
        "x": 5,
    }


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--port", "70000"], "--port from 0 to 65535"),
        (["--time-limit", "0"], "--time-limit"),
        (["--html", "page.html", "--save", "tags.geojson"], "--save would have no effect"),
        (["--step-m", "0.1", "--heading-var-per-step", "1e-4"], "got noise per step (--step-m)"),
        (["--html", "no/such/page.html"], "there is no folder"),
    ],
)
def test_what_the_command_refuses(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "route.csv").write_text("x,y\n3,3\n10,3\n")
    assert main(["studio", "warehouse", "route.csv", "--no-browser", *words]) == 2
    assert said in capsys.readouterr().err


def test_the_server_runs_until_it_is_interrupted(tmp_path):
    route = tmp_path / "route.csv"
    route.write_text("x,y\n3,3\n10,3\n")
    command = [sys.executable, "-m", "driftplan", "studio", "warehouse", str(route), "--no-browser"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    url = process.stderr.readline().strip()
    assert status_of(url) == 200
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert (process.returncode, said.splitlines()[-1]) == (0, "closed")
    assert sorted(tmp_path.iterdir()) == [route]


@pytest.mark.slow
def test_a_widget_answers_as_the_server_does(layout):
    pytest.importorskip("anywidget")
    from driftplan import studio_widget

    scenario = layout.scenario
    widget = studio_widget(
        scenario.world, scenario.routes, scenario.noise, beacons=layout.beacons, max_drift=0.6, time_limit=20
    )
    assert widget.beacons == layout.beacons
    sent, done = [], threading.Event()
    widget.send = lambda said, *_: (sent.append(said), done.set() if {"answer", "error"} & said.keys() else None)
    question = {"scene": {**widget.scene, "beacons": []}, "kind": TAG}
    widget._handle_custom_msg({"id": 7, "what": "fewest", "question": question}, [])
    assert done.wait(60)
    assert sent[-1]["id"] == 7
    assert sent[-1]["answer"]["proven"]
    assert [line for line in sent if line["id"] != 7] == []
    sent.clear()
    done.clear()
    widget._handle_custom_msg({"id": 8, "what": "stop"}, [])  # nobody waits any more: the search ends at its first news
    widget._handle_custom_msg({"id": 8, "what": "fewest", "question": question}, [])
    assert done.wait(60)
    assert sent == [{"id": 8, "error": "stopped"}]


WIDGET = """
from driftplan import OdometryNoise, World, studio_widget
world = World.from_polygons([[(4, 4), (16, 4), (16, 4.4), (4, 4.4)]], bounds=(0, 0, 20, 12), robot_radius=0.3)
studio = studio_widget(world, [[(1, 2), (18, 2)]], OdometryNoise(heading_var_per_m=1e-3), max_drift=0.5)
studio
"""


@pytest.mark.slow
def test_a_kernel_answers_the_page_of_a_notebook():
    """A real Jupyter kernel, asked as the page asks through the comm of its widget."""
    for library in ("anywidget", "nbclient", "ipykernel"):
        pytest.importorskip(library)
    import nbformat
    from jupyter_core.utils import run_sync
    from nbclient import NotebookClient

    notebook = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell(source) for source in (WIDGET, "studio.beacons")]
    )
    client = NotebookClient(notebook, timeout=120)
    with client.setup_kernel():
        client.execute_cell(notebook.cells[0], 0)
        (shown,) = (one.data for one in notebook.cells[0].outputs if "data" in one)
        model = shown["application/vnd.jupyter.widget-view+json"]["model_id"]
        state = client.widget_state[model]
        assert "export default" in state["_esm"]

        def say(data):
            content = {"comm_id": model, "data": data}
            client.kc.shell_channel.send(client.kc.session.msg("comm_msg", content))

        tag = {"id": "A", "x": 9.0, "y": 2.0, "facing_deg": None, "existing": False, "kind": TAG}
        say({"method": "update", "state": {"scene": {**state["scene"], "beacons": [tag]}}, "buffer_paths": []})
        question = {"scene": state["scene"], "start": [1, 2], "goal": [18, 11]}
        say({"method": "custom", "content": {"id": 5, "what": "plan", "question": question}})
        answer = None
        while answer is None:
            message = run_sync(client.kc.get_iopub_msg)(timeout=60)
            said = message["content"].get("data", {}) if message["msg_type"] == "comm_msg" else {}
            answer = said["content"] if "answer" in said.get("content", {}) else None
        assert answer["id"] == 5
        assert [route["name"] for route in answer["answer"]["routes"]] == ["least drift", "shortest"]
        client.execute_cell(notebook.cells[1], 1)
        assert "x=9.0" in notebook.cells[1].outputs[0].data["text/plain"]
