"""Poses and boxes as readers share them, against plain Python and scipy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.recordings.readers.box_rows import make_box_table, rotation_about_up
from mirror.recordings.readers.stored_poses import join_poses, mark_matrices, poses_at, select_poses

RNG = np.random.default_rng(11)
FILE = Path("poses.txt")


def matrices(count: int) -> np.ndarray:
    values = np.tile(np.eye(4), (count, 1, 1))
    values[:, :3, :3] = Rotation.random(count, rng=RNG).as_matrix()
    values[:, :3, 3] = RNG.normal(scale=100.0, size=(count, 3))
    return values


@pytest.mark.parametrize("rows", [3, 4])
def test_matrices_become_poses_and_broken_ones_the_identity(rows: int) -> None:
    given = matrices(6)[:, :rows]
    given[1, :3, 0] *= -1.0
    given[2, 0, 3] = np.nan
    given[4, :3, :3] *= 1.01
    poses, bad = mark_matrices(given)
    assert bad.tolist() == [False, True, True, False, True, False]
    np.testing.assert_allclose(poses.matrix()[~bad, :rows], given[~bad], atol=1e-9)
    np.testing.assert_array_equal(poses.matrix()[bad], np.tile(np.eye(4), (3, 1, 1)))


def test_of_poses_with_one_stamp_the_first_good_one_counts() -> None:
    stamps = np.array([50, 10, 30, 10, 30, 20])
    good = np.array([True, False, True, True, True, False])
    times, rows = select_poses(stamps, good, FILE)
    assert (times.tolist(), rows.tolist()) == ([10, 30, 50], [3, 2, 0])
    with pytest.raises(RecordingError) as caught:
        select_poses(stamps, np.zeros(6, np.bool_), FILE)
    assert caught.value.file == str(FILE)


def test_stamps_beyond_a_trajectory_have_its_first_or_last_pose() -> None:
    poses = Poses(rotation_about_up(np.array([0.0, 1.0])), np.array([[0.0, 0.0, 0.0], [4.0, 2.0, 0.0]]))
    found = poses_at(np.array([-5, 100, 150, 900]), np.array([100, 200]), poses)
    np.testing.assert_allclose(found.translation[:, 0], [0.0, 0.0, 2.0, 4.0], atol=1e-12)
    yaw = Rotation.from_quat(found.rotation, scalar_first=True).as_euler("zyx")[:, 0]
    np.testing.assert_allclose(yaw, [0.0, 0.0, 0.5, 1.0], atol=1e-12)


def test_joined_poses_keep_their_order_and_none_are_none() -> None:
    parts = [Poses.from_matrix(matrices(count)) for count in (2, 1, 3)]
    joined = join_poses(parts)
    np.testing.assert_array_equal(joined.rotation, [row for part in parts for row in part.rotation])
    np.testing.assert_array_equal(joined.translation, [row for part in parts for row in part.translation])
    assert len(join_poses([])) == 0


def test_rows_of_boxes_are_sorted_by_time_and_keep_their_sizes() -> None:
    poses = Poses.from_matrix(matrices(3))
    size_m = np.array([[4.0, 2.0, 1.5], [8.0, 2.5, 3.0], [0.6, 0.5, 1.8]])
    columns = {"timestamp_ns": [30, 10, 10], "track_id": ["a", "b", "c"], "category": "car", "source": "x"}
    rows = make_box_table(poses, size_m, {**columns, "source_version": "1"}).to_pylist()
    assert [row["track_id"] for row in rows] == ["b", "c", "a"]
    for row, place in zip(rows, (1, 2, 0)):
        assert [row["length_m"], row["width_m"], row["height_m"]] == size_m[place].tolist()
        assert [row["tx_m"], row["ty_m"], row["tz_m"]] == poses.translation[place].tolist()
        assert (row["category"], row["score"]) == ("car", None)
    assert make_box_table(join_poses([]), np.empty((0, 3)), {}).num_rows == 0
