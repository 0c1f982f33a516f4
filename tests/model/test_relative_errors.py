"""Relative pose errors in the definitions of KITTI's kit (brute force) and of evo (its numbers)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from driftplan.model.calibration.relative_errors import KITTI_LENGTHS_M, relative_errors


def winding(n=2001):
    """A drive of 1 km and an estimate of it that is too long and turns astray."""
    t = np.arange(n) * 0.1
    heading = 0.6 * np.sin(t / 7)
    said = heading + 0.002 * t + 0.03 * np.sin(t)
    p = np.concatenate([[0], np.cumsum(0.5 * np.exp(1j * heading[:-1]))])
    q = np.concatenate([[0], np.cumsum(0.51 * np.exp(1j * said[:-1]))])
    return np.column_stack([q.real, q.imag, said]), np.column_stack([p.real, p.imag, heading])


def by_the_book(estimate, truth, lengths, step):
    """The definition, frame by frame, in 4 x 4 matrices."""

    def matrix(x, y, heading):
        m = np.eye(4)
        m[:2, :2] = [[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]]
        m[:2, 3] = x, y
        return m

    E, T = [matrix(*p) for p in estimate], [matrix(*p) for p in truth]
    along = [0.0]
    for a, b in pairwise(T):
        along.append(along[-1] + float(np.linalg.norm(b[:3, 3] - a[:3, 3])))
    errors = []
    for length in lengths:
        for first in range(0, len(T), step):
            farther = [k for k in range(first, len(T)) if along[k] > along[first] + length]
            if not farther:
                continue
            true = np.linalg.inv(T[first]) @ T[farther[0]]
            said = np.linalg.inv(E[first]) @ E[farther[0]]
            off = np.linalg.inv(said) @ true
            angle = np.arccos(np.clip((np.trace(off[:3, :3]) - 1) / 2, -1, 1))
            errors.append((100 * np.linalg.norm(off[:3, 3]) / length, np.degrees(angle) / length))
    return np.mean(errors, axis=0)


def test_kitti_errors_are_those_of_the_definition():
    estimate, truth = winding(1001)
    lengths = [50.0, 100.0, 300.0]
    found = relative_errors(estimate, truth, lengths, step=25)
    assert (found.translation_percent, found.rotation_deg_per_m) == pytest.approx(
        by_the_book(estimate, truth, lengths, 25), rel=1e-9
    )


@pytest.mark.parametrize(
    ("length", "segments", "translation", "translation_rms", "rotation", "rotation_rms"),
    [  # evo 1.38.1, metrics.RPE with delta in metres, all_pairs=False, of the same drive
        (20.0, 50, 0.6430371646685797, 0.6625216036366781, 2.0420942238943063, 2.2634583222381828),
        (100.0, 10, 2.838134375179209, 3.021975976534536, 2.394242661148884, 2.5796869327957546),
        (200.0, 5, 8.23993643136893, 8.644616998160794, 4.843339103954131, 5.127921632945944),
    ],
)
def test_evo_finds_the_same_errors(length, segments, translation, translation_rms, rotation, rotation_rms):
    (row,) = relative_errors(*winding(), [length], pairs="evo").lengths
    assert row.segments == segments
    assert row.translation_percent * length / 100 == pytest.approx(translation, rel=1e-9)
    assert row.rotation_deg_per_m * length == pytest.approx(rotation, rel=1e-9)
    assert (row.translation_rms_m, row.rotation_rms_deg) == pytest.approx((translation_rms, rotation_rms), rel=1e-9)


@given(
    turn=st.floats(-3, 3),
    shift=st.lists(st.floats(-100, 100), min_size=3, max_size=3),
    axis=st.sampled_from([[0, 0, 1], [0.6, 0, 0.8]]),
)
@settings(max_examples=40)
def test_frames_do_not_matter_and_the_plane_is_part_of_space(turn, shift, axis):
    estimate, truth = winding(301)
    plain = relative_errors(estimate, truth, [20.0, 60.0])
    moved = np.eye(4)
    moved[:3, :3] = Rotation.from_rotvec(turn * np.array(axis)).as_matrix()
    moved[:3, 3] = shift
    poses = np.tile(np.eye(4), (301, 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("z", estimate[:, 2:]).as_matrix()
    poses[:, :2, 3] = estimate[:, :2]
    in_space = relative_errors((moved @ poses)[:, :3], _space(truth), [20.0, 60.0])
    assert in_space.translation_percent == pytest.approx(plain.translation_percent, rel=1e-9)
    assert in_space.rotation_deg_per_m == pytest.approx(plain.rotation_deg_per_m, rel=1e-6)


def _space(poses):
    full = np.tile(np.eye(4), (len(poses), 1, 1))
    full[:, :3, :3] = Rotation.from_euler("z", poses[:, 2:]).as_matrix()
    full[:, :2, 3] = poses[:, :2]
    return full


def test_lengths_the_drive_does_not_have_are_left_out():
    estimate, truth = winding()
    assert [row.length_m for row in relative_errors(estimate, truth).lengths] == list(KITTI_LENGTHS_M)
    short = relative_errors(estimate[:500], truth[:500])
    assert [row.length_m for row in short.lengths] == [100.0, 200.0]
    assert str(short).count("\n") == 3
    with pytest.raises(ValueError, match=r"expected a path longer than 100 m, got 49\.5 m"):
        relative_errors(estimate[:100], truth[:100])


def test_wrong_arguments_are_refused():
    estimate, truth = winding(101)
    with pytest.raises(ValueError, match="expected estimate and truth of one shape"):
        relative_errors(estimate, truth[:-1], [10.0])
    with pytest.raises(ValueError, match=r"expected estimate of shape \(n, 3\)"):
        relative_errors(estimate[:, :2], truth, [10.0])
    with pytest.raises(ValueError, match="expected lengths_m > 0"):
        relative_errors(estimate, truth, [0.0])
    with pytest.raises(ValueError, match="expected pairs one of"):
        relative_errors(estimate, truth, [10.0], pairs="rpg")
    with pytest.raises(ValueError, match="step"):
        relative_errors(estimate, truth, [10.0], step=0)
    estimate[3, 1] = np.nan
    with pytest.raises(ValueError, match="expected estimate finite"):
        relative_errors(estimate, truth, [10.0])
