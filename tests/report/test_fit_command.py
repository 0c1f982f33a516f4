"""``driftplan fit``: from files to a noise, as a script and a person at a terminal meet it."""

from __future__ import annotations

import argparse
import json

import numpy as np
import pytest

from driftplan.errors import TrajectoryError
from driftplan.model.calibration.simulated_log import simulate_log
from driftplan.model.noise import OdometryNoise
from driftplan.report.fit_command import add_parser, fit
from driftplan.world.noise_files import load_noise

NOISE = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3, distance_scale_error=0.05)
PATH = 8 * [(0, 0), (6, 0), (6, 4), (1, 4)]
FEW = ["--parameters", "distance_scale_error,heading_var_per_m,distance_var_per_m"]


def run(*words):
    parser = argparse.ArgumentParser()
    add_parser(parser.add_subparsers(dest="command"))
    fit(parser.parse_args(["fit", *map(str, words)]))


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


def test_the_noise_of_the_files_is_printed_written_and_drawn(files, tmp_path, capsys):
    run(*files[:2], "--check", *files[2:], "--yaml", tmp_path / "noise.yaml", "--png", tmp_path / "fit.png", "--json")
    said = capsys.readouterr()
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


def test_people_get_a_table(files, capsys):
    run(*files, *FEW, "--lengths-m", "1,2,4,8")
    text = capsys.readouterr().out
    assert "95 % interval" in text
    assert "distance_scale_error" in text
    assert "lateral_var_per_m" not in text
    starts = [line.split()[0] for line in text.splitlines() if line.strip()]
    assert [word for word in starts if word in "1248"] == 2 * list("1248")  # the check, and relative errors as KITTI's
    assert "each fifth of the drives predicted from the other four" in text


def test_one_part_of_a_drive_can_be_checked_on_the_other(files, capsys):
    run(*files[:2], *FEW, "--check-from", "0.6", "--positions-only", "--time-offset-s", "0", "--json")
    answer = json.loads(capsys.readouterr().out)
    assert list(answer["checks"]) == ["the rest of the drives"]
    first = np.loadtxt(files[0], delimiter=",", skiprows=1)
    first = first[first[:, 0] <= 0.6 * first[-1, 0]]
    driven = np.hypot(*np.diff(first[:, 1:3], axis=0).T).sum()
    assert answer["recordings"]["driven_m"] == pytest.approx(driven, rel=1e-6)
    assert answer["fit"]["lengths"][0]["measured_heading_rms"] is None  # JSON knows no nan
    assert answer["time_offsets_s"] == [0.0]


def test_columns_can_be_named(files, tmp_path, capsys):
    table = np.loadtxt(files[0], delimiter=",", skiprows=1)
    np.savetxt(tmp_path / "odd.txt", table[:, [3, 1, 2, 0]])
    run(tmp_path / "odd.txt", files[1], *FEW, "--odometry-columns", "heading,x,y,time", "--json")
    odd = json.loads(capsys.readouterr().out)
    run(*files[:2], *FEW, "--json")
    assert odd["noise"] == pytest.approx(json.loads(capsys.readouterr().out)["noise"], rel=1e-6, abs=1e-12)


def test_wrong_arguments_are_refused(files, tmp_path, capsys):
    with pytest.raises(ValueError, match="expected files in pairs, ODOM TRUTH ODOM TRUTH"):
        run(*files[:3])
    with pytest.raises(ValueError, match="expected files in pairs"):
        run(*files[:2], "--check", files[2])
    with pytest.raises(ValueError, match=r"expected --check-from in \(0, 1\), got 1.5"):
        run(*files[:2], "--check-from", "1.5")
    with pytest.raises(ValueError, match="expected parameters from"):
        run(*files[:2], "--parameters", "slip")
    with pytest.raises(TrajectoryError, match="No such file"):
        run(tmp_path / "nowhere.csv", files[1])
    for words, said in (
        (["--lengths-m", "one"], "expected lengths M,M,... in metres"),
        (["--yaml", tmp_path / "nowhere" / "noise.yaml"], "there is no folder"),
        (["--odometry-kind", "wheels"], "invalid choice"),
    ):
        with pytest.raises(SystemExit):
            run(*files[:2], *words)
        assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
