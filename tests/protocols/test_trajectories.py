from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mirror.errors import UsageError
from mirror.geometry.poses import Poses
from mirror.protocols.views.trajectories import VehicleTrajectory, read_trajectory
from mirror.view.video import write_video

SECOND = 1_000_000_000
UTM = np.array([441_000.0, 4_475_000.0, 600.0])


def quarter_turn(by: np.ndarray | float = 0.0) -> VehicleTrajectory:
    """A line along x, then a turn to the left, then along y."""
    half = np.sqrt(0.5)
    rotation = np.array([[1.0, 0.0, 0.0, 0.0], [half, 0.0, 0.0, half]])
    return VehicleTrajectory(
        np.array([7 * SECOND, 8 * SECOND]), Poses(rotation, np.array([[0.0, 0, 0], [10.0, 0, 0]]) + by)
    )


def test_shift_is_to_the_vehicles_left() -> None:
    moved = quarter_turn().shift(left_m=2.0, forward_m=1.0)
    np.testing.assert_allclose(moved.world_SE3_ego.translation, [[1.0, 2.0, 0.0], [8.0, 1.0, 0.0]], atol=1e-12)
    aside = quarter_turn(UTM).shift(left_m=0.001).world_SE3_ego.translation[0] - UTM
    np.testing.assert_allclose(aside, (0.0, 0.001, 0.0), atol=1e-9)


def test_resampled_trajectory_starts_at_the_first_pose_and_stays_on_the_line() -> None:
    for hz in (1.0, 3.0, 10.0, 29.97, 240.0):
        often = quarter_turn().resample(hz)
        assert len(often) == int(hz) + 1
        assert often.timestamps_ns[0] == 7 * SECOND and often.timestamps_ns[-1] <= 8 * SECOND
        assert np.all(np.diff(often.timestamps_ns) > 0)
        share = (often.timestamps_ns - 7 * SECOND) / SECOND
        np.testing.assert_allclose(often.world_SE3_ego.translation[:, 0], 10.0 * share, atol=1e-9)
    for none in (0.0, -1.0, np.nan):
        with pytest.raises(UsageError, match=r"--hz: .* images per second"):
            quarter_turn().resample(none)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_poses_are_read_back_from_a_file(tmp_path: Path, suffix: str) -> None:
    line = quarter_turn(UTM)
    table = pd.DataFrame(line.world_SE3_ego.to_columns())
    table["timestamp_ns"] = line.timestamps_ns
    path = tmp_path / f"poses{suffix}"
    if suffix == ".csv":
        table.to_csv(path, index=False)
    else:
        table.to_parquet(path)
    back = read_trajectory(path)
    np.testing.assert_array_equal(back.timestamps_ns, line.timestamps_ns)
    np.testing.assert_allclose(back.world_SE3_ego.translation, line.world_SE3_ego.translation, atol=1e-9)
    table.drop(columns="timestamp_ns").to_csv(tmp_path / "even.csv", index=False)
    assert np.diff(read_trajectory(tmp_path / "even.csv", hz=4.0).timestamps_ns).tolist() == [SECOND // 4]
    assert len(read_trajectory(tmp_path / "even.csv", hz=30.0).resample(30.0)) == len(table)
    with pytest.raises(UsageError, match=r"--hz: 0 images per second"):
        read_trajectory(tmp_path / "even.csv", hz=0.0)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("qw,qx\n1,0\n", "no column qy"),
        ("qw,qx,qy,qz,tx_m,ty_m,tz_m\n", "no rows"),
        ("qw,qx,qy,qz,tx_m,ty_m,tz_m\n0,0,0,0,1,1,1\n", "row 0"),
        ("qw,qx,qy,qz,tx_m,ty_m,tz_m\n1,0,0,0,,1,1\n", "row 0, column tx_m: nan; expected a finite number"),
        ("qw,qx,qy,qz,tx_m,ty_m,tz_m\n1,0,0,0,1,1,1\n1,0,0,0,1,x,1\n", "row 1, column ty_m: x; expected a finite"),
        ("qw,qx,qy,qz,tx_m,ty_m,tz_m,timestamp_ns\n1,0,0,0,0,1,1,5\n1,0,0,0,0,1,1,5\n", "do not increase"),
    ],
)
def test_files_without_poses_are_refused(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "poses.csv").write_text(text)
    with pytest.raises(UsageError, match=problem):
        read_trajectory(tmp_path / "poses.csv")


def test_video_has_all_given_images(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    images = [np.full((37, 64, 3), 20 * number, np.uint8) for number in range(10)]
    assert write_video(tmp_path / "street.mp4", iter(images), 10.0) == 10
    with av.open(str(tmp_path / "street.mp4")) as container:
        shown = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(shown) == 10 and shown[0].shape == (36, 64, 3)
    assert np.abs(np.array([one.mean() for one in shown]) - 20.0 * np.arange(10)).max() < 3.0
    for wrong in ([], [images[0], images[0][:20]]):
        with pytest.raises(UsageError):
            write_video(tmp_path / "none.mp4", wrong, 10.0)
    assert [path.name for path in tmp_path.iterdir()] == ["street.mp4"]
