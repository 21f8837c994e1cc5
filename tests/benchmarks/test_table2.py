"""The benchmark of the paper's table on public datasets: what it runs, on fixtures in the layouts of their owners."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.table2 import DATASETS, arrange_euvs, block_circles, main, report_rows
from mirror.errors import UsageError
from tests.recordings.formats.kitti360 import CAMERAS, write_kitti360
from tests.recordings.formats.nuplan import write_nuplan
from tests.recordings.formats.nuscenes import CHANNELS, write_nuscenes
from tests.recordings.formats.street import SECOND_NS, StreetDrive, synth_drives

_LATER_NS = 1000 * SECOND_NS
# Frames of the fixtures: UTM zone 48 at the first road block of MTGS, the map of Boston, and Mercator's projection.
_BLOCK_M = (365_580.0, 144_010.0, 0.0)
_BOSTON_M = (1620.0, 1180.0, 0.0)
_KITTI_M = (1107.0, 3826.0, 115.0)


class _OwnImages(StreetDrive):
    """A drive whose images differ from those of other drives: equal images in two roles of a split are refused."""

    def image(self, camera: str, index: int, suffix: str = ".jpg") -> bytes:
        own = int.from_bytes(self.name.encode()[-4:], "big") % 1000
        return super().image(camera, 1000 * own + index, suffix)


def _drives() -> tuple[StreetDrive, ...]:
    return tuple(_OwnImages(**vars(drive)) for drive in synth_drives())


def _later(drive: StreetDrive, name: str, by_ns: int) -> StreetDrive:
    """The same line, driven later by another vehicle."""
    objects = tuple(replace(one, track_id=f"{name}-{one.track_id}") for one in drive.objects)
    return replace(
        drive, name=name, vehicle=name, pose_ns=drive.pose_ns + by_ns, box_ns=drive.box_ns + by_ns, objects=objects,
        poses_at=lambda stamps: drive.poses_at(stamps - by_ns),
        image_ns={camera: stamps + by_ns for camera, stamps in drive.image_ns.items()},
    )  # fmt: skip


def _nuscenes(root: Path) -> Path:
    return write_nuscenes(root, tuple(drive.placed(_BOSTON_M).with_cameras(tuple(CHANNELS)) for drive in _drives()))


def _nuplan(root: Path) -> Path:
    drive = _drives()[0].placed(_BLOCK_M).upright().with_cameras(("front_wide", "rear"))
    for number in range(4):
        write_nuplan(root, _later(drive, f"log-{number}", number * _LATER_NS), epsg=32648)
    return root / "splits" / "mini"


def _kitti360(root: Path) -> Path:
    drives = []
    for drive in (_drives()[0], _later(_drives()[0], "2013_05_28_drive_0001_sync", _LATER_NS)):
        chosen = drive.placed(_KITTI_M).with_cameras(tuple(CAMERAS))
        stamps = chosen.image_ns["front_wide"]
        drives.append(replace(chosen, image_ns=dict.fromkeys(CAMERAS, stamps), pose_ns=stamps))
    return write_kitti360(root / "KITTI-360", tuple(drives))


def _euvs(root: Path) -> Path:
    pytest.importorskip("pycolmap", reason="arranges the models of EUVS: extra calibration")
    from tests.recordings.formats.colmap import write_colmap

    scene = write_colmap(root / "scene", tuple(drive.with_cameras(("front_wide",)) for drive in _drives()))
    names = sorted(path.relative_to(scene / "images").as_posix() for path in scene.rglob("*.jpg"))
    held = names[: len(names) // 2]
    (scene / "test_set.txt").write_text("\n".join(held))
    (scene / "sparse" / "0").mkdir(parents=True, exist_ok=True)
    for path in (scene / "sparse").glob("*.*"):
        path.rename(scene / "sparse" / "0" / path.name)
    return scene


FIXTURES: dict[str, Callable[[Path], Path]] = {
    "nuscenes-mini": _nuscenes,
    "nuplan": _nuplan,
    "mtgs-blocks": _nuplan,
    "kitti-360": _kitti360,
    "euvs": _euvs,
}


@pytest.mark.parametrize("name", DATASETS)
def test_a_folder_becomes_a_divided_dataset(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A method without an implementation ends the run after the dataset is divided; the next run says what is done."""
    folder = FIXTURES[name](tmp_path / "data")
    words = [name, str(folder), "--out", str(tmp_path / "out"), "--methods", "none", "--scenes", "1"]
    with pytest.raises(UsageError, match=r"reconstruct .* ended with code 2"):
        main(words)
    said = capsys.readouterr().out
    roles = json.loads((tmp_path / "out" / "dataset" / "splits" / "table2.json").read_text())["assignments"]
    expected = {"nuscenes-mini": ["train", "train"], "kitti-360": ["held_out", "train"], "euvs": ["held_out", "train"]}
    assert sorted(roles.values()) == expected.get(name, ["held_out", "train", "train", "train"])
    if name == "euvs":
        assert [key for key, role in roles.items() if role == "held_out"] == [key for key in roles if ".test" in key]
    with pytest.raises(UsageError):
        main(words)
    again = capsys.readouterr().out
    assert again.count("# finished: mirror") == said.count("\nmirror ") + said.startswith("mirror ") - 1


@pytest.mark.parametrize("name", DATASETS)
def test_a_dry_run_prints_the_commands_and_writes_nothing(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([name, str(tmp_path), "--out", str(tmp_path / "out"), "--dry-run"]) == 0
    verbs = [line.split()[1] for line in capsys.readouterr().out.splitlines()]
    first = ["ingest"] if name == "mtgs-blocks" else ["rois", "ingest"]
    assert verbs == [*first, "split", *["reconstruct", "render", "evaluate"] * 2]
    assert not (tmp_path / "out").exists()


def test_road_blocks_lie_in_the_cities_of_their_zones() -> None:
    """Singapore, Pittsburgh and Boston by degrees that an atlas gives."""
    cities = ((103.8, 1.3), (103.8, 1.3), (-80.0, 40.4), (-71.06, 42.36), (-80.0, 40.4), (-80.0, 40.4))
    for (lon, lat, _, _), city in zip(block_circles(), cities, strict=True):
        np.testing.assert_allclose((lon, lat), city, atol=0.05)


def test_a_scene_of_euvs_without_a_part_is_refused(tmp_path: Path) -> None:
    scene = _euvs(tmp_path)
    (scene / "test_set.txt").write_text("nobody.jpg")
    with pytest.raises(UsageError, match="all images are of one part"):
        arrange_euvs(scene, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (scene / "test_set.txt").unlink()
    with pytest.raises(UsageError, match=r"test_set\.txt is missing"):
        arrange_euvs(scene, tmp_path / "out")


def test_rows_stand_beside_those_of_the_paper() -> None:
    figures = {"training/psnr": 20.0, "training/ssim": 0.5, "novel/psnr_cc": 15.0, "novel/ssim": 0.4}
    lines = list(report_rows("mtgs-blocks", [{"method": "hybridworldsim", "figures": figures}]))
    assert lines[2] == "| hybridworldsim | 20.00 | 0.500 | not measured | 15.00 | 0.400 | not measured |"
    assert lines[4] == "| the paper's hybridworldsim | 29.17 | 0.873 | 0.129 | 22.11 | 0.606 | 0.219 |"
