"""Output folders of other generators, in their layouts, become submissions."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.arrays import UInt8
from mirror.cli.main import main
from mirror.dataset import Dataset
from mirror.errors import DatasetError, UsageError
from mirror.evaluation.submission.check import check_submission
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.evaluation.submission.untrusted import open_untrusted
from mirror.evaluation.submission.writing import write_submission
from mirror.export.nuscenes import channel_name
from mirror.protocols.document import Protocol, load_protocol
from mirror.protocols.views import Plan, plan_views
from mirror.protocols.views.view import RenderView
from mirror.schema.files import read_json
from mirror.view.video import write_video
from mirror_baselines.released import GENERATORS, make_renderer
from mirror_baselines.released.files import ReleasedFiles
from mirror_baselines.released.generators import APPEARANCE
from mirror_baselines.released.submission import to_recorded_size

WIDTH, HEIGHT = 48, 32


def grey_level(number: int) -> int:
    """A grey that tells a view from the others."""
    return 20 + 4 * number


def write_image(path: Path, level: int, width: int = WIDTH, height: int = HEIGHT) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((height, width, 3), level, np.uint8))


def plan_of(dataset: Dataset, name: str = "generation") -> Plan:
    return plan_views(dataset, load_protocol(name), "novel")


def nuscenes_stem(view: RenderView) -> str:
    return f"n015-2018-07-24-11-22-45+0800__{channel_name(view.camera)}__{view.timestamp_ns // 1000}"


def write_opendwm(folder: Path, plan: Plan, **size: int) -> None:
    """As `export_generation_result_as_nuscenes_data.py` does: the paths of `sample_data`, key frames and others."""
    for number, view in enumerate(plan.views):
        kind = "samples" if view.frame_index % 2 else "sweeps"
        write_image(
            folder / kind / channel_name(view.camera) / f"{nuscenes_stem(view)}.jpg", grey_level(number), **size
        )


def read_levels(submission: Path, plan: Plan) -> list[float]:
    found = []
    for view in plan.views:
        pixels = cv2.imread(str(submission / view.path))
        assert pixels.shape == (view.height_px, view.width_px, 3)
        found.append(float(np.median(pixels)))
    return found


def import_outputs(dataset: Dataset, method: str, outputs: Path, out: Path, *more: str) -> int:
    words = ["baseline", str(dataset.root), "--method", method, "--split", "novel", "--protocol", "generation"]
    return main([*words, "--outputs", str(outputs), "--out", str(out), *more])


@pytest.mark.parametrize("size", [{}, {"width": 24, "height": 16}, {"width": 96, "height": 65}])
def test_images_of_opendwm(dataset: Dataset, tmp_path: Path, size: dict[str, int]) -> None:
    plan, out = plan_of(dataset), tmp_path / "submission"
    write_opendwm(tmp_path / "output", plan, **size)
    assert import_outputs(dataset, "opendwm", tmp_path / "output", out) == 0
    assert check_submission(open_untrusted(out), plan, decode=True).problems == ()
    assert read_levels(out, plan) == pytest.approx([grey_level(number) for number in range(len(plan.views))], abs=1)
    manifest = read_json(out / "manifest.json", SubmissionManifest)
    assert (manifest.method.name, manifest.appearance.policy) == ("OpenDWM", "other")


def test_images_of_magicdrive_show_the_lower_part(dataset: Dataset, tmp_path: Path) -> None:
    plan, out = plan_of(dataset), tmp_path / "submission"
    for number, view in enumerate(plan.views):
        for sample in range(2):
            name = f"{nuscenes_stem(view)}_gen{sample}.jpg"
            level = grey_level(number) + sample
            write_image(tmp_path / "output" / "gen_video" / channel_name(view.camera) / name, level, height=30)
    assert import_outputs(dataset, "magicdrive-v2", tmp_path / "output", out, "--sample", "1") == 0
    assert read_levels(out, plan) == pytest.approx([grey_level(number) + 1 for number in range(len(plan.views))], abs=1)
    pixels = cv2.imread(str(out / plan.views[0].path))
    # 48 x 30 of 48 x 32 pixels: the upper two rows were cut off by the generator.
    assert pixels[:2].max() == 0 < pixels[2:].min()


def test_videos_are_placed_by_a_table(dataset: Dataset, protocol: Protocol, tmp_path: Path) -> None:
    """Each group has its folder; a video has other frames than the ones that the protocol asks for."""
    plan = plan_views(dataset, protocol, "novel")
    outputs, rows = tmp_path / "output", []
    keys = list(dict.fromkeys(sequence_of(view) for view in plan.views))
    for number, (group, traversal, camera) in enumerate(keys):
        start = min(view.timestamp_ns for view in plan.views if sequence_of(view) == (group, traversal, camera))
        file = Path(group) / f"edit-{number}" / "output.mp4"
        images = [np.full((HEIGHT, WIDTH, 3), 40 + number + 5 * frame, np.uint8) for frame in range(13)]
        write_video(outputs / file, images, 7, quality=4)
        # The dataset has 10 images a second; the rate at which the video plays does not count.
        rows.append([file, traversal, camera, start - 100_000_000, 10])
    files = ReleasedFiles(GENERATORS["driveeditor"], outputs, write_clips(tmp_path / "clips.csv", rows))
    sources = files.locate(plan)
    for view in plan.views:
        assert sources[view.path].frame == view.frame_index - first_frame(plan, view) + 1
    out = tmp_path / "submission"
    write_submission(dataset, plan, make_renderer(files), files.generator.method, APPEARANCE, out)
    expected = [40 + keys.index(sequence_of(view)) + 5 * (sources[view.path].frame or 0) for view in plan.views]
    assert read_levels(out, plan) == pytest.approx(expected, abs=2)


def first_frame(plan: Plan, view: RenderView) -> int:
    return min(other.frame_index for other in plan.views if sequence_of(other) == sequence_of(view))


def sequence_of(view: RenderView) -> tuple[str, str, str]:
    return view.group, view.traversal_id, view.camera


def write_clips(path: Path, rows: Sequence[Sequence[object]]) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["file", "traversal_id", "camera", "timestamp_ns", "hz"])
        writer.writerows(rows)
    return path


@pytest.mark.parametrize("name", ["vehicle-translation", "editing-accuracy"])
def test_groups_with_moved_vehicles_have_folders(tiny_dataset: Dataset, tmp_path: Path, name: str) -> None:
    protocol = load_protocol(name)
    # Every fifth frame: planning the edits of all would be most of the test.
    protocol = protocol.model_copy(update={"frames": protocol.frames.model_copy(update={"every": 5})})
    plan = plan_views(tiny_dataset, protocol, "novel")
    shown = {}
    for number, view in enumerate(plan.views):
        channel, level = channel_name(view.camera), 20 + number % 200
        path = tmp_path / view.group / "samples" / channel / f"x__{channel}__{(view.timestamp_ns + 500) // 1000}.png"
        write_image(path, level, view.width_px // 2, view.height_px // 2)
        shown[view.path] = path, level
    files = ReleasedFiles(GENERATORS["opendwm"], tmp_path)
    assert len(plan.views) > 4 and len({view.group for view in plan.views}) > 4
    assert {path: source.file for path, source in files.locate(plan).items()} == {
        path: file for path, (file, _) in shown.items()
    }
    for (view,), pixels in make_renderer(files)(tiny_dataset, plan):
        assert pixels.shape == (view.height_px, view.width_px, 3)
        assert pixels[view.height_px // 2, view.width_px // 2] == pytest.approx(shown[view.path][1], abs=1)


def test_missing_views_are_counted(dataset: Dataset, tmp_path: Path) -> None:
    plan = plan_of(dataset)
    write_opendwm(tmp_path / "output", plan)
    gone = sorted((tmp_path / "output").rglob("*.jpg"))[::5]
    for path in gone:
        path.unlink()
    files = ReleasedFiles(GENERATORS["opendwm"], tmp_path / "output")
    with pytest.raises(DatasetError, match=f"{len(gone)} of {len(plan.views)} views have no image"):
        files.locate(plan)
    out = tmp_path / "submission"
    assert import_outputs(dataset, "opendwm", tmp_path / "output", out) == 2
    assert not out.exists()


def test_two_images_of_an_instant_are_refused(dataset: Dataset, tmp_path: Path) -> None:
    plan = plan_of(dataset)
    write_opendwm(tmp_path / "output", plan)
    path = sorted((tmp_path / "output").rglob("*.jpg"))[0]
    write_image(tmp_path / "output" / "again" / path.name, 3)
    with pytest.raises(DatasetError, match="same instant"):
        ReleasedFiles(GENERATORS["opendwm"], tmp_path / "output").locate(plan)


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ([["missing.mp4", "t", "front_wide", 0, 10]], "no such video"),
        ([["a.mp4", "t", "front_wide", "soon", 10]], "line 2 has no valid"),
        ([["a.mp4", "t", "front_wide", 0]], "line 2 has no valid"),
        ([["a.mp4", "t", "front_wide", 0, 0]], "line 2: 0 Hz"),
        ([["a.mp4", "t", "front_wide", 0, "nan"]], "line 2: nan Hz"),
    ],
)
def test_faults_of_the_table_are_named(
    dataset: Dataset, tmp_path: Path, rows: Sequence[Sequence[object]], problem: str
) -> None:
    (tmp_path / "output").mkdir()
    (tmp_path / "output" / "a.mp4").write_bytes(b"")
    files = ReleasedFiles(GENERATORS["driveeditor"], tmp_path / "output", write_clips(tmp_path / "clips.csv", rows))
    with pytest.raises(UsageError, match=problem):
        files.locate(plan_of(dataset))


def test_aspect_ratio() -> None:
    square: UInt8 = np.zeros((32, 32, 3), np.uint8)
    with pytest.raises(DatasetError, match="32 x 32 px"):
        to_recorded_size(square, WIDTH, HEIGHT, Path("a.png"), lower_part=True)
    low: UInt8 = np.zeros((20, 48, 3), np.uint8)
    with pytest.raises(DatasetError, match="48 x 20 px"):
        to_recorded_size(low, WIDTH, HEIGHT, Path("a.png"))


def test_wrong_options(dataset: Dataset, tmp_path: Path) -> None:
    words = ["baseline", str(dataset.root), "--split", "novel", "--out", str(tmp_path / "submission")]
    (tmp_path / "output").mkdir()
    outputs = ["--outputs", str(tmp_path / "output")]
    assert main([*words, "--method", "opendwm"]) == 2
    assert main([*words, "--method", "nearest_frame", *outputs]) == 2
    assert main([*words, "--method", "driveeditor", *outputs]) == 2
    assert main([*words, "--method", "opendwm", *outputs, "--clips", str(tmp_path / "clips.csv")]) == 2
    assert not (tmp_path / "submission").exists()
