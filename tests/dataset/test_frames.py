"""Frames: images, poses, calibrations, boxes and masks, against the exact truth of straight drives."""

from __future__ import annotations

import hashlib
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

import mirror
from mirror.dataset import Dataset
from mirror.dataset.frames import FrameSequence
from mirror.dataset.images.decoding import run_jobs
from mirror.dataset.images.video_decoders import VideoDecoders
from mirror.dataset.index import build_index
from mirror.dataset.store import Store
from mirror.errors import DatasetError, UsageError
from mirror.schema.files import encode_table, read_table
from mirror.schema.index_tables import INDEX_IMAGES
from mirror.schema.tables import BOXES, CALIBRATIONS, EGO_POSES, IMAGES, MASKS
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass, box, calibration, mask_row
from tests.builders.index import segment_folder, tamper

CAMERAS = ("front_wide", "front_left", "front_right")
SIZE = (48, 32)
MS = 1_000_000


def image(seed: int, size: tuple[int, int] = SIZE) -> bytes:
    """A JPEG of smooth random colours."""
    rough = np.random.default_rng(seed).integers(0, 255, (4, 6, 3), np.uint8)
    return cv2.imencode(".jpg", cv2.resize(rough, size, interpolation=cv2.INTER_CUBIC))[1].tobytes()


ENCODED = {camera: image(seed) for seed, camera in enumerate(CAMERAS)}


def reference_rgb(data: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


@pytest.fixture(scope="module")
def one_pass() -> Pass:
    return Pass("a", frames=6, heading_deg=50.0, offset_m=3.0, images=ENCODED, dropped=frozenset({("front_left", 4)}))


@pytest.fixture(scope="module")
def builder(tmp_path_factory: pytest.TempPathFactory, one_pass: Pass) -> Builder:
    made = Builder(tmp_path_factory.mktemp("dataset"))
    made.scene("a")
    made.drive("d1", [one_pass])
    made.drive("d2", [Pass("a", EPOCH + 60 * SECOND, frames=3)])
    build_index(made.root)
    return made


@pytest.fixture(scope="module")
def frames(builder: Builder) -> FrameSequence:
    return mirror.open(builder.root).where(drive="d1").frames()


def test_a_sequence_is_indexed_and_sliced(builder: Builder, frames: FrameSequence) -> None:
    assert len(frames) == 6
    assert [frame.frame_index for frame in frames] == [0, 1, 2, 3, 4, 5]
    assert frames[-1].timestamp_ns == EPOCH + 500 * MS
    assert [frame.frame_index for frame in frames[1::2][::-1]] == [5, 3, 1]
    assert (frames[2].scene_id, frames[2].traversal_id) == ("a", f"a.d1.{EPOCH // MS}")
    with pytest.raises(IndexError):
        _ = frames[6]
    both = mirror.open(builder.root).frames()
    assert [frame.traversal_id.split(".")[1] for frame in both] == ["d1"] * 6 + ["d2"] * 3
    cut = mirror.open(builder.root).where(time=(EPOCH + 100 * MS, EPOCH + 300 * MS)).frames()
    assert [frame.frame_index for frame in cut] == [1, 2]
    assert repr(cut) == "FrameSequence(2 frames of 1 traversals)"


def test_images_are_those_of_the_files(frames: FrameSequence) -> None:
    frame = frames[1]
    assert tuple(frame.images) == CAMERAS
    for camera, image in frame.images.items():
        assert image.read(verify=True) == ENCODED[camera]
        assert np.array_equal(image.decode(), reference_rgb(ENCODED[camera]))
        assert image.exposure_start_ns < image.timestamp_ns < image.exposure_end_ns
    planes = frame.decode()
    assert planes.flags.c_contiguous and planes.dtype == np.uint8 and planes.shape == (3, 3, 32, 48)
    for part, camera in zip(planes, CAMERAS):
        assert np.array_equal(part.transpose(1, 2, 0), reference_rgb(ENCODED[camera]))
    assert np.array_equal(frame.decode(threads=1), planes)
    assert np.array_equal(frame.decode(["front_right", "front_wide"], verify=True), planes[[2, 0]])


def test_a_missing_camera_is_missing(frames: FrameSequence) -> None:
    frame = frames[4]
    assert tuple(frame.images) == ("front_wide", "front_right")
    assert frame.decode().shape[0] == 2
    with pytest.raises(UsageError, match="'front_left' in frame 4"):
        frame.decode(["front_left"])
    planes = np.full((3, 3, 32, 48), 7, np.uint8)
    frame.decode_into(planes, CAMERAS)
    assert (planes[1] == 7).all() and not (planes[0] == 7).all()
    with pytest.raises(UsageError, match="48 x 32 px; expected 48 x 31 px"):
        frame.decode_into(np.zeros((1, 3, 31, 48), np.uint8), ["front_wide"])


def test_a_view_of_some_cameras_has_only_those(builder: Builder) -> None:
    frame = mirror.open(builder.root).where(camera=["front_right", "front_wide"]).frames()[0]
    assert tuple(frame.images) == ("front_wide", "front_right")


def test_poses_are_composed_at_each_images_own_instant(frames: FrameSequence, one_pass: Pass) -> None:
    yaw = np.pi / 2 - np.radians(one_pass.heading_deg)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    # The camera looks along the ego's x: its x is -y of the ego, its y is -z, its z is x.
    mounting = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    for frame in frames:
        ego = one_pass.position(np.array([frame.timestamp_ns]))[0]
        assert np.abs(frame.world_SE3_ego.translation[0] - ego).max() < 1e-9
        for image in frame.images.values():
            number = CAMERAS.index(image.camera)
            at = one_pass.position(np.array([image.timestamp_ns]))[0] + turn @ [1.5, 0.1 * number, 1.6]
            matrix = image.world_SE3_camera.matrix()[0]
            assert np.abs(matrix[:3, 3] - at).max() < 1e-9
            assert np.abs(matrix[:3, :3] - turn @ mounting).max() < 1e-12
            assert (image.camera_model.fx_px, image.camera_model.width_px) == (40.0, 48)


def test_calibrations_by_stage_and_time(tmp_path: Path) -> None:
    builder = Builder(tmp_path)
    builder.scene("a")
    (traversal,) = builder.drive("d", [Pass("a")])
    middle = EPOCH + 200 * MS
    rows = [
        calibration("front_wide", 0, SIZE),
        calibration("front_wide", 0, SIZE, stage="online", fx_px=41.0, valid_from_ns=None, valid_to_ns=middle),
        calibration("front_wide", 0, SIZE, stage="online", fx_px=42.0, valid_from_ns=middle + 1),
        calibration("front_left", 1, SIZE, stage="online", fx_px=43.0, valid_to_ns=EPOCH),
    ]
    builder.layer(traversal, "calibrations", "board@1", CALIBRATIONS, rows)
    refined = [calibration("front_wide", 0, SIZE, stage="refined", fx_px=50.0)]
    builder.layer(traversal, "calibrations", "ba@1", CALIBRATIONS, refined)
    build_index(tmp_path)
    dataset = mirror.open(tmp_path)

    def focal(view: Dataset, frame: int, camera: str = "front_wide") -> float:
        return view.frames()[frame].images[camera].camera_model.fx_px

    assert focal(dataset, 0) == 40.0
    board = dataset.with_layers(calibrations="board@1")
    assert [focal(board, frame) for frame in (0, 2, 3)] == [41.0, 41.0, 42.0]
    assert focal(board.with_layers(stage="factory"), 0) == 40.0
    assert focal(board.with_layers(stage="factory").with_layers(calibrations="ba@1", stage="refined"), 0) == 50.0
    with pytest.raises(DatasetError, match="camera front_left"):
        focal(board, 3, "front_left")
    with pytest.raises(DatasetError, match="calibrate the camera"):
        focal(dataset.with_layers(calibrations="ba@1"), 0, "front_left")
    with pytest.raises(UsageError, match="did you mean 'board@1'"):
        dataset.with_layers(calibrations="bord@1")
    with pytest.raises(UsageError, match="unknown stage"):
        dataset.with_layers(stage="final")


def test_a_pose_layer_replaces_the_recorded_poses(tmp_path: Path) -> None:
    builder = Builder(tmp_path)
    builder.scene("a")
    first, second = (builder.drive(f"d{k}", [Pass("a", EPOCH + k * 60 * SECOND)])[0] for k in range(2))
    recorded = read_table(builder.layout.recorded(first) / "ego_poses.parquet", EGO_POSES)
    rows = [{**row, "tz_m": 2.5} for row in recorded.to_pylist()]
    builder.layer(first, "poses", "slam@2", EGO_POSES, rows)
    builder.layer(second, "poses", "short@1", EGO_POSES, recorded.to_pylist())
    build_index(tmp_path)
    dataset = mirror.open(tmp_path)
    refined = dataset.with_layers(poses="slam@2")
    assert refined.frames()[0].world_SE3_ego.translation[0, 2] == 2.5
    assert dataset.frames()[0].world_SE3_ego.translation[0, 2] == 0.0
    assert refined.with_layers(poses="recorded").frames()[0].world_SE3_ego.translation[0, 2] == 0.0
    with pytest.raises(DatasetError, match="slam@2"):
        _ = refined.where(drive="d1").frames()[0].world_SE3_ego
    with pytest.raises(DatasetError, match="poses before and after every image"):
        _ = dataset.where(drive="d1").with_layers(poses="short@1").frames()[0].world_SE3_ego


class TestBoxes:
    @pytest.fixture
    def dataset(self, tmp_path: Path) -> Dataset:
        builder = Builder(tmp_path)
        builder.scene("a")
        traversal, *_ = builder.drive("d", [Pass("a", heading_deg=90.0), Pass("a", EPOCH + 60 * SECOND)])
        stamps = [EPOCH + 60 * MS + k * 200 * MS for k in range(2)]
        rows = [box(stamp, name, vx_mps=3.0, vz_mps=0.0) for stamp in stamps for name in ("one", "two")]
        builder.layer(traversal, "boxes", "petr@1", BOXES, rows)
        build_index(tmp_path)
        return mirror.open(tmp_path)

    def test_the_nearest_instant_within_half_a_period(self, dataset: Dataset) -> None:
        frames = dataset.frames()
        # Frames at 0, 100, 200, 300, 400 ms; boxes at 60 and 260 ms; half a period is 100 ms.
        assert [len(frame.boxes()) for frame in frames[:5]] == [2, 2, 2, 2, 0]
        assert [frame.boxes().timestamp_ns - EPOCH for frame in frames[:4]] == [60 * MS, 60 * MS, 260 * MS, 260 * MS]
        assert len(frames[5].boxes()) == 0 and len(frames[5].boxes("world")) == 0
        assert frames[0].boxes().track_id == ("one", "two")
        assert frames[0].boxes().source == ("petr@1", "petr@1")

    def test_frames_of_reference(self, dataset: Dataset) -> None:
        frame = dataset.frames()[1]
        ego, world, camera = (frame.boxes(name) for name in ("ego", "world", "camera:front_left"))
        assert np.allclose(ego.pose.translation, [[10.0, 0.0, 0.8]] * 2)
        # Eastward at 10 m/s, at the centre after 250 ms: the boxes' instant is 190 ms before.
        assert np.allclose(world.pose.translation, [[8.1, 0.0, 0.8]] * 2, atol=1e-9)
        assert world.velocity_mps.shape == camera.velocity_mps.shape == (2, 3)
        assert np.allclose(world.velocity_mps, [[3.0, 0.0, 0.0]] * 2, atol=1e-12)
        # The image of front_left is of 101 ms: the car has gone on by 0.41 m, the camera sits 0.1 m left.
        assert np.allclose(camera.pose.translation, [[0.1, 0.8, 8.09]] * 2, atol=1e-9)
        assert np.allclose(camera.velocity_mps, [[0.0, 0.0, 3.0]] * 2, atol=1e-12)
        assert np.array_equal(world.size_m, [[4.0, 2.0, 1.6]] * 2)
        with pytest.raises(UsageError, match="camera:front_wide"):
            frame.boxes("camera:rear")

    def test_several_layers_must_be_chosen_between(self, dataset: Dataset) -> None:
        builder = Builder(dataset.layout.root)
        builder.scene("a")
        traversal = dataset.traversals()[0]
        row = box(EPOCH, "mine", source="me", source_version="3", score=None, vx_mps=None)
        builder.layer(traversal, "boxes", "me@3", BOXES, [row])
        build_index(dataset.root)
        frames = mirror.open(dataset.root).frames()
        with pytest.raises(UsageError, match=r"boxes of me@3, petr@1.*--boxes petr@1"):
            frames[0].boxes()
        mine = mirror.open(dataset.root).with_layers(boxes="me@3").frames()
        assert mine[0].boxes().track_id == ("mine",) and np.isnan(mine[0].boxes().score[0])
        assert np.isnan(mine[0].boxes("world").velocity_mps).any()
        # A layer of one instant has no period: its boxes are of that instant alone.
        assert len(mine[1].boxes()) == 0
        with pytest.raises(DatasetError, match="no boxes layer me@3"):
            mine[5].boxes()


def test_masks_and_static_masks(tmp_path: Path) -> None:
    builder = Builder(tmp_path)
    builder.scene("a")
    (traversal,) = builder.drive("d", [Pass("a", images=ENCODED)])
    grey = np.zeros((32, 48), np.uint8)
    grey[10:20, 5:9] = 255
    png = cv2.imencode(".png", grey)[1].tobytes()
    (tmp_path / "rigs" / "front.png").write_bytes(png)
    rig = builder.layout.rig("rig")
    rig.write_text(rig.read_text().replace('"static_mask": null', '"static_mask": "front.png"', 1))
    uri = f"traversals/{traversal}/layers/masks/sam@1/x.png"
    rows = [mask_row("front_wide", EPOCH, uri, png), mask_row("front_wide", EPOCH, uri + "x", png, kind="sky")]
    folder = builder.layer(traversal, "masks", "sam@1", MASKS, rows)
    (folder / "x.png").write_bytes(png)
    build_index(tmp_path)
    first, second = mirror.open(tmp_path).frames()[:2]
    image = first.images["front_wide"]
    dynamic, sky = image.masks()
    assert (dynamic.kind, sky.kind, dynamic.source) == ("dynamic", "sky", "sam")
    assert np.array_equal(dynamic.decode(), grey)
    with pytest.raises(DatasetError, match=r"x\.pngx.*sky mask"):
        sky.decode()
    assert second.images["front_wide"].masks() == [] and first.images["front_left"].masks() == []
    assert np.array_equal(image.static_mask(), grey)
    assert first.images["front_left"].static_mask() is None


class TestBrokenImages:
    @pytest.fixture
    def dataset(self, tmp_path: Path) -> Dataset:
        builder = Builder(tmp_path)
        builder.scene("a")
        builder.drive("d", [Pass("a", frames=1, images=ENCODED)])
        build_index(tmp_path)
        return mirror.open(tmp_path)

    def faults(self, dataset: Dataset, *, verify: bool = False) -> str:
        with pytest.raises(DatasetError) as caught:
            dataset.frames()[0].decode(verify=verify)
        text = str(caught.value)
        assert f"front_left/{EPOCH + MS}.jpg" in text and f"camera front_left, timestamp_ns {EPOCH + MS}" in text
        return text

    def path(self, dataset: Dataset) -> Path:
        return dataset.layout.root / dataset.frames()[0].images["front_left"].uri

    def test_missing(self, dataset: Dataset) -> None:
        self.path(dataset).unlink()
        assert "No such file" in self.faults(dataset)

    def test_cut_short(self, dataset: Dataset) -> None:
        self.path(dataset).write_bytes(ENCODED["front_left"][:-40])
        assert "ends after" in self.faults(dataset)

    def test_overwritten_to_the_same_length(self, dataset: Dataset) -> None:
        data = ENCODED["front_left"]
        for broken in (data[: len(data) // 2] + bytes(len(data) - len(data) // 2), bytes(len(data))):
            self.path(dataset).write_bytes(broken)
            assert "cannot be decoded" in self.faults(dataset)

    def test_another_image_of_the_same_length(self, dataset: Dataset) -> None:
        data = bytearray(ENCODED["front_left"])
        data[-30] ^= 1
        self.path(dataset).write_bytes(data)
        dataset.frames()[0].decode()
        assert "differ from the recorded ones" in self.faults(dataset, verify=True)

    def test_another_size(self, dataset: Dataset) -> None:
        other = image(1, (16, 12))
        room = len(ENCODED["front_left"]) - len(other)
        assert room >= 0
        self.path(dataset).write_bytes(other + bytes(room))
        assert "the image is 16 x 12 px; expected 48 x 32 px" in self.faults(dataset)


def test_a_uri_that_leads_out_is_refused(tmp_path: Path) -> None:
    builder = Builder(tmp_path / "dataset")
    builder.scene("a")
    builder.drive("d", [Pass("a", frames=1, images=ENCODED)])
    (tmp_path / "secret").write_bytes(b"x" * 2000)
    build_index(builder.root)
    path = segment_folder(builder.root) / "images" / "a.parquet"
    table = read_table(path, INDEX_IMAGES)
    outside = ["traversals/../../secret"] * table.num_rows
    changed = table.set_column(table.column_names.index("uri"), "uri", [outside])
    tamper(builder.root, {"images/a.parquet": encode_table(changed, INDEX_IMAGES)})
    with pytest.raises(DatasetError, match="leads out of the dataset"):
        mirror.open(builder.root).frames()[0].decode()


def write_video(path: Path, stamps: np.ndarray) -> None:
    """A video of 64 x 48 px with a key frame every 12 frames; the grey value of each frame is 8 times its number."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"g": "12", "bf": "2", "crf": "10"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.time_base = stream.time_base = Fraction(1, 15360)
        for number, pts in enumerate(stamps.tolist()):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 8 * number, np.uint8), format="rgb24")
            frame.pts, frame.time_base = pts, stream.time_base
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


@pytest.mark.parametrize("limit", [1, 2])
def test_more_videos_are_read_than_are_open_at_once(tmp_path: Path, limit: int) -> None:
    names = ("a.mp4", "b.mp4", "c.mp4")
    for name in names:
        write_video(tmp_path / name, np.arange(6) * 512)
    decoders = VideoDecoders(Store(tmp_path), limit=limit)
    for number in (0, 5, 2):
        for name in names:
            pixels = decoders.decode(name, 512 * number)
            assert pixels is not None and abs(float(pixels.mean()) - 8.0 * number) < 2.5


def test_images_in_a_video_are_found_by_their_stamp(tmp_path: Path) -> None:
    builder = Builder(tmp_path, cameras=("front_wide",), size=(64, 48))
    builder.scene("a")
    (traversal,) = builder.drive("d", [Pass("a", frames=30)])
    folder = builder.layout.recorded(traversal)
    # Uneven stamps.
    stamps = np.cumsum(np.random.default_rng(0).integers(2, 9, 30)) * 100
    write_video(folder / "front_wide.mp4", stamps)
    video = folder / "front_wide.mp4"
    uri = str(video.relative_to(tmp_path))
    rows = read_table(folder / "images.parquet", IMAGES).to_pylist()
    with av.open(str(video)) as container:
        found = sorted(packet.pts for packet in container.demux(video=0) if packet.size)
    for row, pts in zip(rows, found):
        row.update(uri=uri, codec="video", video_pts=pts, byte_length=video.stat().st_size, sha256=None)
    rows[-1]["video_pts"] = found[-1] + 1
    builder.layer(traversal, "redaction", "moved@1", IMAGES, rows)
    build_index(tmp_path)
    frames = mirror.open(tmp_path).frames()
    order = [*np.random.default_rng(1).permutation(29), *range(5, 12)]
    for index in order:
        pixels = frames[int(index)].images["front_wide"].decode()
        assert pixels.shape == (48, 64, 3)
        assert abs(float(pixels.mean()) - 8.0 * index) < 2.5
    with pytest.raises(DatasetError, match=rf"front_wide\.mp4.*timestamp_ns {rows[-1]['timestamp_ns']}"):
        frames[29].images["front_wide"].decode()
    video.unlink()
    with pytest.raises(DatasetError, match="cannot be opened"):
        mirror.open(tmp_path).frames()[0].images["front_wide"].decode()


def test_a_video_is_verified_once_for_all_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    builder = Builder(tmp_path, cameras=("front_wide",), size=(64, 48))
    builder.scene("a")
    (traversal,) = builder.drive("d", [Pass("a", frames=4)])
    folder = builder.layout.recorded(traversal)
    video = folder / "front_wide.mp4"
    write_video(video, np.arange(4) * 512)
    data = video.read_bytes()
    rows = read_table(folder / "images.parquet", IMAGES).to_pylist()
    for number, row in enumerate(rows):
        row.update(uri=str(video.relative_to(tmp_path)), codec="video", video_pts=512 * number, byte_length=len(data))
        row.update(byte_offset=0, sha256=hashlib.sha256(data).digest())
    builder.layer(traversal, "redaction", "moved@1", IMAGES, rows)
    build_index(tmp_path)
    read_bytes: list[int] = []

    def read_range(store: Store, uri: str, offset: int, length: int, read: Any = Store.read_range) -> bytes:
        read_bytes.append(length)
        return read(store, uri, offset, length)

    monkeypatch.setattr(Store, "read_range", read_range)
    images = [frame.images["front_wide"] for frame in mirror.open(tmp_path).frames()]
    for number, image in enumerate(images):
        assert abs(float(image.decode(verify=True).mean()) - 8.0 * number) < 2.5
    assert read_bytes == [len(data)]
    assert images[1].read(verify=True) == data
    # The last byte, which no frame needs.
    video.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    for image in [frame.images["front_wide"] for frame in mirror.open(tmp_path).frames()][:2]:
        image.decode()
        with pytest.raises(DatasetError, match=r"front_wide\.mp4.*differ"):
            image.decode(verify=True)
    with pytest.raises(DatasetError, match="differ"):
        images[1].read(verify=True)


def test_jobs_run_dearest_first_and_hand_on_their_error() -> None:
    order: list[int] = []
    run_jobs([lambda k=k: order.append(k) for k in range(4)], [1, 9, 5, 7], threads=1)
    assert order == [1, 3, 2, 0]

    def fail() -> None:
        raise DatasetError("no")

    with pytest.raises(DatasetError):
        run_jobs([fail, lambda: order.append(9)], [1, 2], threads=2)
    assert order[-1] == 9
    run_jobs([], [])
