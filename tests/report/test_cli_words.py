"""What the command says to people and scripts: typos, options without effect, errors, help, pipes, gains."""

from __future__ import annotations

import io
import json
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
import shapely
import yaml

import driftplan
from driftplan import Beacon, BeaconKind, OdometryNoise, World, plan_route, predict_drift, save_world
from driftplan.beacons.beacon_files import beacons_geojson
from driftplan.report.cli import in_options, main
from driftplan.report.commands import COMMANDS
from driftplan.report.commands.answer import Progress
from driftplan.report.commands.plan import bound_in_words, gained_in_words

ENDS = ("--start", "1,1", "--goal", "9,1")
NOISE = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
ROOM = World.from_polygons([shapely.box(4, 0, 6, 7)], bounds=(0, 0, 10, 8), robot_radius=0.3)


@pytest.fixture(scope="module")
def route():
    return plan_route(ROOM, (1, 1), (9, 1), NOISE, iterations=1)


@pytest.fixture
def room(tmp_path):
    save_world(ROOM, tmp_path / "room.geojson")
    return tmp_path / "room.geojson"


@pytest.fixture
def searched(route, monkeypatch):
    """Nothing is searched: what `plan_route` was asked, and the route of this room."""
    asked = []
    monkeypatch.setattr("driftplan.plan_route", lambda *values, **options: asked.append((values, options)) or route)
    return asked


@pytest.mark.parametrize("name", COMMANDS)
def test_a_typo_is_answered_with_the_nearest_option_of_that_subcommand(refused, name):
    for option in COMMANDS[name].options[::3]:
        refused(name, option.flag[:-1] + "x", match=rf"unrecognized arguments: \S+; did you mean {option.flag[:-3]}")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_subcommand_shows_two_examples_that_parse(run, name, tmp_path, monkeypatch):
    from driftplan.report.cli import build_parser

    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"0,0\n1,0\n")))
    out = run(name, "--help").out
    assert len(COMMANDS[name].examples) == 2
    for words in COMMANDS[name].examples:
        assert f"driftplan {name} {words}".strip() in out
        args = build_parser().parse_args([name, *words.partition(" <")[0].split()])
        given = {word[2:].replace("-", "_") for word in words.split() if word.startswith("--")}
        COMMANDS[name].check(args, given)


@pytest.mark.parametrize(
    ("words", "near"),
    [
        (("plna",), "did you mean plan"),
        (("place", "warehouse", "r.csv", "--kind", "rfdi"), "did you mean rfid"),
        (("plan", "warehouse", "--minimise", "lenght"), "did you mean length"),
        (("study", "chekc", "study.yaml"), "did you mean check"),
        (("completion", "fish"), "expected one of bash, zsh"),
    ],
)
def test_a_typo_of_a_value_is_answered_with_the_nearest(refused, words, near):
    refused(*words, match=rf"invalid choice: '\w+'; {near}")


def test_noise_options_are_folded_into_a_pointer(run):
    brief, full = run("plan", "--help").out, run("plan", "--help-noise").out
    assert "see --help-noise" in brief
    assert "rad^2/m" not in brief
    assert "rad^2/m" in full
    assert "--start" not in full.split("options]")[1].split("Examples:")[0]


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["place", "M", "P", "--heading-std-deg", 2], "--heading-std-deg would have no effect: that is not what"),
        (["place", "M", "P", "--kind", "bearing", "--range-std-m", 1], "--range-std-m would have no effect"),
        (["place", "M", "P", "--kind", "bearing", "--std-per-m", 1], "--std-per-m would have no effect"),
        (["place", "M", "P", "--candidates", "b.geojson", "--view-angle-deg", 90], "--view-angle-deg would have no"),
        (["place", "M", "P", "--through-walls"], "--through-walls would have no effect"),
        (["design", "M", "P", "--max-drift", 1, "--price-per-m", 1, "--kind", "heading", "--position-std-m", 1],
         "--position-std-m would have no effect"),
        (["place", "M", "P", "--candidates", "b.geojson", "--kind", "landmark"], "--kind would have no effect"),
        (["plan", "M", *ENDS, "--redundancy", 2], "--redundancy would have no effect: there are no --beacons"),
        (["plan", "M", *ENDS, "--estimator", "filter"], "--estimator would have no effect: there are no --beacons"),
        (["compare", "M", "P", "--planner", "bitstar"], "--planner would have no effect: nothing is planned"),
    ],
)  # fmt: skip
def test_options_without_effect_are_refused(refused, words, match):
    refused(*words, match=match)


@pytest.mark.parametrize(
    ("name", "message", "said"),
    [
        ("place", "expected max_drift, or max_beacons", "expected --max-drift, or --max-beacons"),
        ("fit", "expected kind one of a, b", "expected --odometry-kind one of a, b"),
        ("plan", "expected seed a whole number", "expected --seed a whole number"),
        ("place", "a range: expected estimator='filter'", "a range: expected --estimator filter"),
        ("plan", "start (0, 0) is not free", "start (0, 0) is not free"),
        ("predict", "--at is for max_driftiness", "--at is for max_driftiness"),
    ],
)
def test_errors_speak_of_options(name, message, said):
    assert in_options(message, COMMANDS[name]) == said


def test_errors_are_json_too(run, room, tmp_path):
    for words, kind, code in (
        (("predict", tmp_path / "no.csv"), "TrajectoryError", 2),
        (("plan", room, "--start", "5,1", "--goal", "9,1"), "StartError", 2),
        (("plan", room, "--strat", "5,1"), "UsageError", 2),
        (("place", room, tmp_path / "p.csv", "--max-drift", 0.03, "--range-m", 0.2), "InfeasibleError", 3),
    ):
        (tmp_path / "p.csv").write_text("1,1\n1,7\n")
        got, out, err = run(*words, "--json")
        answer = json.loads(out)
        assert (got, answer["error"]["code"], answer["error"]["kind"]) == (code, code, kind)
        assert answer["error"]["message"] in err


def test_snap_moves_a_start_in_a_wall_and_says_so(run, room, searched):
    code, _, err = run("plan", room, "--start", "4.2,3", "--goal", "11,1", "--snap")
    assert code == 0
    ((_, start, goal, _), _) = searched[0]
    assert ROOM.is_free(start)
    assert ROOM.is_free(goal)
    assert "start (4.2, 3) is not free: moved 0.504 m to (3.696, 3)" in err
    assert re.search(r"goal \(11, 1\) is off the map.*: moved 1.3 m", err)


def test_the_shortest_route_stands_beside_the_answer(run, room, searched, route):
    answer = json.loads(run("plan", room, *ENDS, "--json").out)["route"]
    assert answer["shortest"]["rms_m"] == route.shortest.rms
    assert answer["rms_m"] == route.rms


def test_what_the_robot_makes_of_a_reading_reaches_the_planner(run, room, searched, tmp_path):
    tags = tmp_path / "tags.geojson"
    tags.write_bytes(beacons_geojson([Beacon(BeaconKind.rfid(1.5, 0.1), 2.0, 1.0)]))
    for words, estimator in (((), "reset"), (("--beacons", tags, "--estimator", "filter"), "filter")):
        answer = json.loads(run("plan", room, *ENDS, *words, "--json").out)
        assert searched[-1][1]["estimator"] == answer["estimator"] == estimator


def test_what_was_gained_is_said_in_numbers_or_denied(route):
    detour = predict_drift([(1, 1), (1, 7.6), (9, 7.6), (9, 1)], NOISE)
    better = replace(route, shortest=replace(route, drift=detour, path=detour.xy))
    less = 100 * (1 - route.rms / better.shortest.rms)
    assert f"{less:.1f} % less drift at the goal" in gained_in_words(better)[0]
    assert "Nothing is gained" in gained_in_words(replace(route, shortest=route))[0]
    assert gained_in_words(replace(route, shortest=None)) == []


def test_a_bound_is_said_for_what_it_covers_and_not_at_all_when_it_is_nothing(route):
    some = bound_in_words(replace(route, bound=0.9 * route.rms, bound_heading_std=0.5))
    assert "Proven for routes with headings off by at most 0.5 rad" in some
    assert "Proven for all routes" in bound_in_words(replace(route, bound=0.9 * route.rms, bound_heading_std=np.inf))
    assert "not known" in bound_in_words(replace(route, bound=1e-9))


def test_a_path_comes_from_standard_input_and_one_goes_to_standard_output(run, room, searched, route, monkeypatch):
    printed = run("plan", room, *ENDS, "--csv", "-")
    lines = printed.out.splitlines()
    assert lines[:2] == ["# driftplan file version 1, frame map, metres", "x_m,y_m"]
    assert len(lines) == 2 + len(route.path)
    assert "lowest drift" in printed.err
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(printed.out.encode())))
    answer = json.loads(run("predict", "-", "--heading-deg", 3, "--json").out)["paths"][0]
    assert answer["file"] == "standard input"
    assert answer["points"][-1]["rms_m"] == pytest.approx(route.rms)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"1,2\n3,x\n")))
    assert run("predict", "-").err.startswith("driftplan predict: standard input, line 2: ")


def piped(run, monkeypatch, content, *words):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))
    return run(*words)


def test_every_kind_of_input_but_studies_comes_from_standard_input_too(run, room, tmp_path, monkeypatch):
    """What one subcommand writes to ``-`` the next one reads."""
    drive = driftplan.simulate_log(3 * [(1, 1), (3, 1), (3, 6)], NOISE, rng=1)
    for name, log in zip(("odometry", "truth"), drive, strict=True):
        xy = log.xy if name == "truth" else np.column_stack([log.positions.real, log.positions.imag])
        heading = log.heading if name == "truth" else log.headings
        rows = np.column_stack([log.times, xy, heading]).tolist()
        lines = ["time,x,y,heading", *(",".join(map(repr, row)) for row in rows)]
        (tmp_path / f"{name}.csv").write_text("\n".join(lines))
    (tmp_path / "path.csv").write_text("1,1\n3,1\n3,6\n")
    odometry = (tmp_path / "odometry.csv").read_bytes()
    noise = piped(run, monkeypatch, odometry, "fit", "-", tmp_path / "truth.csv", "--accept-faults", "--yaml", "-")
    assert noise.code == 0, noise.err
    told = piped(run, monkeypatch, noise.out.encode(), "predict", tmp_path / "path.csv", "--noise", "-", "--json")
    assert told.code == 0, told.err
    kept = {key: value for key, value in yaml.safe_load(noise.out).items() if value}
    assert json.loads(told.out)["noise"] == pytest.approx(kept)
    tags = beacons_geojson([Beacon(BeaconKind.rfid(1.5, 0.1), 2.0, 1.0)])
    for words in (("predict", tmp_path / "path.csv"), ("plan", room, *ENDS, "--iterations", 1, "--max-drift", 5)):
        answer = piped(run, monkeypatch, tags, *words, "--beacons", "-")
        assert answer.code == 0, answer.err
    trips = piped(run, monkeypatch, b"1,1,3,6\n3,6,1,1\n", "plan", room, "--trips", "-", "--time-limit", 2, "--json")
    assert len(json.loads(trips.out)["routes"]) == 2
    there = piped(
        run,
        monkeypatch,
        driftplan.bundled_map("office").read_bytes(),
        "plan",
        "-",
        "--start",
        "36,12",
        "--goal",
        "6,5",
        "--json",
    )
    assert json.loads(there.out)["map"] == "standard input"
    wrong = piped(run, monkeypatch, b"junk", "predict", tmp_path / "path.csv", "--beacons", "-")
    assert wrong.err.startswith("driftplan predict: standard input, line 1: not JSON")


def test_a_picture_on_standard_output_is_a_png(run, tmp_path, monkeypatch):
    (tmp_path / "p.csv").write_text("0,0\n5,0\n")
    taken = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(taken, write_through=True))
    assert main(["predict", str(tmp_path / "p.csv"), "--picture", "-"]) == 0
    assert taken.getvalue().startswith(b"\x89PNG")


def test_one_standard_output_takes_one_thing(run, refused, room, searched):
    code, out, _ = run("plan", room, *ENDS, "--csv", "-", "--json")
    assert code == 2
    assert "--json or a file on standard output, got both" in json.loads(out)["error"]["message"]
    refused("plan", room, *ENDS, "--csv", "-", "--geojson", "-", match="a name of its own, got - twice")


@pytest.mark.parametrize(("form", "begins"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_pictures_are_png_svg_or_pdf_and_every_file_is_named(run, tmp_path, form, begins):
    (tmp_path / "p.csv").write_text("0,0\n5,0\n")
    file = tmp_path / f"drift.{form}"
    code, _, err = run("predict", tmp_path / "p.csv", "--picture", file)
    assert code == 0
    first = file.read_bytes()
    assert first.startswith(begins)
    assert err == f"wrote {file}\n"
    run("predict", tmp_path / "p.csv", "--picture", file)
    assert file.read_bytes() == first


def test_progress_is_for_terminals(capsys, monkeypatch):
    for is_terminal in (False, True):
        monkeypatch.setattr(sys.stderr, "isatty", lambda is_terminal=is_terminal: is_terminal)
        monkeypatch.setattr("driftplan.report.commands.answer._QUIET_S", 0.0)
        monkeypatch.setattr("driftplan.report.commands.answer._TELL_EVERY_S", 0.001)
        with Progress() as progress:
            Progress.news = "half of it"
            while is_terminal and "half of it" not in (seen := capsys.readouterr().err):
                assert progress._thread.is_alive()
        if is_terminal:
            assert re.search(r"0 s: half of it", seen)
        else:
            assert capsys.readouterr().err == ""
