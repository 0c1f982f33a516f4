"""``driftplan fit``: from files to a noise, as a script and a person at a terminal meet it."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml

from driftplan.model.calibration.recordings import simulate_log
from driftplan.model.noise import OdometryNoise
from driftplan.world.noise_files import load_noise

NOISE = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3, distance_scale_error=0.05)
PATH = 8 * [(0, 0), (6, 0), (6, 4), (1, 4)]
FEW = ["--parameters", "distance_scale_error,heading_var_per_m,distance_var_per_m"]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Two drives of one robot: odometry as poses, truth beside it."""
    folder = tmp_path_factory.mktemp("drives")
    names = []
    for k in (0, 1):
        log, truth = simulate_log(PATH, NOISE, rng=k, truth_position_std_m=0.003)
        poses = np.column_stack([log.times, log.positions.real, log.positions.imag, log.headings])
        np.savetxt(folder / f"odom{k}.csv", poses, header="time,x,y,heading", comments="", delimiter=",")
        seen = np.column_stack([truth.times, truth.xy, truth.heading])
        np.savetxt(folder / f"truth{k}.csv", seen, header="time,x,y,heading", comments="", delimiter=",")
        names += [folder / f"odom{k}.csv", folder / f"truth{k}.csv"]
    return names


def test_the_noise_of_the_files_is_printed_written_and_drawn(files, tmp_path, run):
    written = ("--yaml", tmp_path / "noise.yaml", "--png", tmp_path / "fit.png", "--json")
    said = run("fit", *files[:2], "--check", *files[2:], *FEW, *written)
    answer = json.loads(said.out)
    low, high = answer["intervals"]["distance_scale_error"]
    assert low < 0.05 < high
    noise = load_noise(tmp_path / "noise.yaml")
    assert noise.distance_scale_error == answer["noise"]["distance_scale_error"]
    assert (tmp_path / "fit.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert list(answer["checks"]) == ["odom1.csv"]
    rows = answer["checks"]["odom1.csv"]["lengths"]
    assert all(row["measured_rms_m"] > 0 and row["predicted_rms_m"] > 0 for row in rows)
    assert answer["recordings"]["breaks"] == 0
    relative = answer["relative_errors"]["lengths"]
    assert [row["length_m"] for row in relative] == [row["length_m"] for row in answer["held_out"]["lengths"]]
    assert relative[-1]["translation_percent"] > 4  # 5 % too long, and a little astray
    assert answer["heading_offsets_rad"] == [0.0]
    assert "fitting 1 drive" in said.err


def test_people_get_a_table(files, run):
    text = run("fit", *files, *FEW, "--lengths-m", "1,2,4,8").out
    assert "95 % interval" in text
    assert "distance_scale_error" in text
    assert "lateral_var_per_m" not in text
    starts = [line.split()[0] for line in text.splitlines() if line.strip()]
    assert [word for word in starts if word in "1248"] == 2 * list("1248")  # the check, and relative errors as KITTI's
    assert "each fifth of the drives predicted from the other four" in text


def test_one_part_of_a_drive_can_be_checked_on_the_other(files, run):
    words = ("--check-from", "0.6", "--positions-only", "--time-offset-s", "0", "--json")
    answer = json.loads(run("fit", *files[:2], *FEW, *words).out)
    assert list(answer["checks"]) == ["the rest of the drives"]
    first = np.loadtxt(files[0], delimiter=",", skiprows=1)
    first = first[first[:, 0] <= 0.6 * first[-1, 0]]
    driven = np.hypot(*np.diff(first[:, 1:3], axis=0).T).sum()
    assert answer["recordings"]["driven_m"] == pytest.approx(driven, rel=1e-6)
    assert answer["fit"]["lengths"][0]["measured_heading_rms"] is None  # JSON knows no nan
    assert answer["time_offsets_s"] == [0.0]


def test_columns_can_be_named(files, tmp_path, run):
    table = np.loadtxt(files[0], delimiter=",", skiprows=1)
    np.savetxt(tmp_path / "odd.txt", table[:, [3, 1, 2, 0]])
    named = ("--odometry-columns", "heading,x,y,time", "--json")
    odd = json.loads(run("fit", tmp_path / "odd.txt", files[1], *FEW, *named).out)
    plain = json.loads(run("fit", *files[:2], *FEW, "--json").out)
    assert odd["noise"] == pytest.approx(plain["noise"], rel=1e-6, abs=1e-12)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--check", "odom1.csv"], "expected files in pairs, ODOM TRUTH ODOM TRUTH"),
        (["--check-from", "1.5"], r"expected --check-from in \(0, 1\), got 1.5"),
        (["--parameters", "slip"], "expected --parameters from"),
        (["--check", "nowhere.csv", "truth1.csv"], "nowhere.csv: .*No such file"),
        (["--lengths-m", "one"], "expected M,M,... in metres"),
        (["--yaml", "nowhere/noise.yaml"], "there is no folder"),
        (["--odometry-kind", "wheels"], "invalid choice"),
    ],
)
def test_wrong_arguments_are_refused(refused, files, monkeypatch, words, said):
    monkeypatch.chdir(files[0].parent)
    there = set(files[0].parent.iterdir())
    refused("fit", *files[:2], *words, match=said)
    assert set(files[0].parent.iterdir()) == there


def test_a_fit_that_is_not_to_be_used_writes_nothing_unless_asked(files, tmp_path, run, refused):
    odometry = np.loadtxt(files[0], delimiter=",", skiprows=1)
    odometry[:, 1:3] *= 1000
    np.savetxt(tmp_path / "mm.csv", odometry, header="time,x,y,heading", comments="", delimiter=",")
    words = ["fit", tmp_path / "mm.csv", files[1], *FEW, "--yaml", tmp_path / "noise.yaml"]
    refused(*words, match=r"times the true distance: millimetres or metres\?.* --accept-faults")
    assert not (tmp_path / "noise.yaml").exists()
    said = run(*words, "--accept-faults")
    assert "millimetres or metres?" in said.out
    assert (tmp_path / "noise.yaml").exists()


def test_covariances_for_messages_need_the_robots_speed(files, tmp_path, run, refused):
    words = ("fit", *files[:2], *FEW, "--lengths-m", "2,4,8", "--ros", tmp_path / "odom.yaml")
    refused(*words, match="expected --speed, the robot's in m/s, with --ros")
    assert not (tmp_path / "odom.yaml").exists()
    run(*words, "--speed", "0.5", "--message-rate-hz", "20")
    found = yaml.safe_load((tmp_path / "odom.yaml").read_text())
    assert np.reshape(found["twist_covariance"], (6, 6))[0, 0] == pytest.approx(1e-3 * 0.5 * 20, rel=0.5)
    assert np.shape(found["pose_covariance"]) == (36,)


def test_wheels_are_read_with_their_track_width(tmp_path, run, files):
    log, _ = simulate_log(PATH, NOISE, rng=0, truth_position_std_m=0.003)
    sides = [np.append((np.abs(log.moves) + way * log.turns * 0.25) / np.diff(log.times), 0) for way in (-1, 1)]
    rows = np.column_stack([log.times, *sides])
    np.savetxt(tmp_path / "wheels.csv", rows, header="time,v_left,v_right", comments="", delimiter=",")
    words = (*FEW, "--lengths-m", "2,4,8", "--json")
    found = json.loads(run("fit", tmp_path / "wheels.csv", files[1], "--track-width-m", "0.5", *words).out)
    assert found["noise"]["distance_scale_error"] == pytest.approx(0.05, abs=0.02)


def test_a_recorded_drive_is_a_path_to_predict(files, run):
    noise = ("--heading-deg", "2", "--after-m", "10")
    said = json.loads(run("predict", files[1], *noise, "--json").out)["paths"][0]
    assert said["length_m"] == pytest.approx(sum(np.hypot(*np.diff(PATH, axis=0).T)), rel=0.01)
    assert len(said["points"]) < 100  # corners, not samples
