"""Torch samples carry all that is needed to use them right, against OpenCV, closed forms and exact images of rays."""

from __future__ import annotations

import json
import multiprocessing
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.dataset import Dataset
from mirror.dataset.index import build_index
from mirror.errors import DatasetError, UsageError
from mirror.geometry.cameras import Camera
from mirror.schema.files import write_bytes
from mirror.schema.tables import BOXES, CALIBRATIONS, MASKS
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass, box, calibration, mask_row

torch = pytest.importorskip("torch")
from torch.utils.data import DataLoader, default_collate  # noqa: E402

from mirror.dataset.torch import LENS_MODELS, FrameDataset, IterableFrames, camera_of, is_forked  # noqa: E402

LENSES = {
    "front_wide": Camera("kannala_brandt", 96, 64, 40.0, 41.0, 47.0, 33.0, (0.02, -0.01, 0.001, 0.0)),
    "front_left": Camera("brown_conrady", 96, 64, 60.0, 61.0, 49.0, 31.0, (-0.2, 0.05, 0.001, -0.002, 0.0)),
    "front_right": Camera("pinhole", 80, 64, 60.0, 60.0, 41.0, 31.0),
    "rear": Camera("f_theta", 72, 48, 1.0, 1.0, 36.0, 24.0, (0.0, 35.0, 0.0, -1.0)),
}
STEP = 40.0


def slopes_image(lens: Camera) -> np.ndarray:
    """An image whose red and green are the slopes of its pixels' rays: what any other lens must show there is known."""
    rays = lens.rays().direction
    image = np.zeros((lens.height_px, lens.width_px, 3), np.uint8)
    image[..., :2] = np.clip(np.round(128.0 + STEP * np.nan_to_num(rays[..., :2] / rays[..., 2:])), 0, 255)
    return image


def png(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".png", pixels[..., ::-1] if pixels.ndim == 3 else pixels)[1].tobytes()


IMAGES = {name: slopes_image(lens) for name, lens in LENSES.items()}
# A mask of the fisheye: a block of instances 3 and 5.
INSTANCES = np.zeros((64, 96), np.uint8)
INSTANCES[20:40, 30:50], INSTANCES[20:40, 50:60] = 3, 5
EGO = np.zeros((64, 96), np.uint8)
EGO[50:] = 255


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two drives: one of four lenses of three sizes, with boxes and masks, and one of smaller images."""
    builder = Builder(tmp_path_factory.mktemp("dataset"), cameras=tuple(LENSES), lenses=LENSES)
    builder.scene("a")
    encoded = {name: png(image) for name, image in IMAGES.items()}
    (first,) = builder.drive("d0", [Pass("a", frames=4, images=encoded, codec="png", dropped=frozenset({("rear", 2)}))])
    rows = [box(EPOCH, "t2"), box(EPOCH, "t7", category="van", vz_mps=0.0, score=None)]
    rows += [box(EPOCH + 100_000_000, "t7", category="van", tx_m=12.0)]
    builder.layer(first, "boxes", "petr@1", BOXES, rows)
    folder = builder.layout.layer(first, "masks", "sam", "1")
    uri = f"traversals/{first}/layers/masks/sam@1/one.png"
    write_bytes(builder.root / uri, png(INSTANCES))
    of_frame = [mask_row("front_wide", EPOCH, uri, png(INSTANCES), kind=kind) for kind in ("dynamic", "instance")]
    assert builder.layer(first, "masks", "sam@1", MASKS, of_frame) == folder
    write_bytes(builder.root / "rigs" / "rig-front_wide.png", png(EGO))
    builder.write_rig({"front_wide": "rig-front_wide.png"})
    builder.rig_id = "small"
    builder.write_rig()
    builder.lenses = {name: lens.resized(48, 32) for name, lens in LENSES.items()}
    small = {name: png(cv2.resize(image, (48, 32))) for name, image in IMAGES.items()}
    later = Pass("a", EPOCH + 60 * SECOND, frames=3, images=small, codec="png")
    (second,) = builder.drive("d1", [later])
    builder.layer(second, "boxes", "petr@1", BOXES, [box(later.entry_ns, "t1", category="bus")])
    build_index(builder.root)
    return mirror.open(builder.root)


@pytest.fixture(scope="module")
def first(dataset: Dataset) -> Dataset:
    return dataset.where(drive="d0")


def test_a_sample_has_the_whole_lens(first: Dataset) -> None:
    item, frame = FrameDataset(first)[0], first.frames()[0]
    for row, (name, lens) in enumerate(LENSES.items()):
        assert LENS_MODELS[int(item["lens"][row])] == lens.model
        assert camera_of(item, row) == lens
        image = frame.images[name]
        stamps = (image.timestamp_ns, image.exposure_start_ns, image.exposure_end_ns)
        assert stamps == tuple(int(item[key][row]) for key in ("timestamp_ns", "exposure_start_ns", "exposure_end_ns"))
        assert np.array_equal(item["world_SE3_camera"][row].numpy(), image.world_SE3_camera.matrix()[0])
    lost = FrameDataset(first)[2]
    assert lost["valid"].tolist() == [True, True, True, False] and lost["lens"][3] == -1
    with pytest.raises(UsageError, match="its camera has none"):
        camera_of(lost, 3)
    with pytest.raises(UsageError, match="an index for each axis"):
        camera_of(lost)


def test_a_drive_of_several_sizes_is_padded_and_its_intrinsics_hold(dataset: Dataset) -> None:
    samples = FrameDataset(dataset)
    assert samples.shape == (64, 96)
    for index, frame in enumerate(dataset.frames()):
        item = samples[index]
        assert item["images"].shape == (4, 3, 64, 96) and item["pixel_valid"].shape == (4, 64, 96)
        for row, name in enumerate(LENSES):
            image = frame.images.get(name)
            height, width = (0, 0) if image is None else (image.height_px, image.width_px)
            assert (int(item["height_px"][row]), int(item["width_px"][row])) == (height, width)
            if image is not None:
                assert np.array_equal(item["images"][row, :, :height, :width].permute(1, 2, 0), image.decode())
                assert np.array_equal(item["intrinsics"][row], image.camera_model.intrinsic_matrix())
            inside = torch.zeros(64, 96, dtype=torch.bool)
            inside[:height, :width] = True
            assert torch.equal(item["pixel_valid"][row], inside)
            assert not item["images"][row][:, ~inside].any()


@pytest.mark.parametrize("resize", [None, (40, 90), 0.5, 1.5])
def test_undistorted_images_show_the_rays_of_their_matrix(first: Dataset, resize: object) -> None:
    item = FrameDataset(first, undistort=True, resize=resize)[0]
    for row, (name, lens) in enumerate(LENSES.items()):
        assert LENS_MODELS[int(item["lens"][row])] == "pinhole" and not item["distortion"][row].any()
        height, width = int(item["height_px"][row]), int(item["width_px"][row])
        if resize is None:
            assert (height, width) == (lens.height_px, lens.width_px)
        # By K alone: no other of our functions has a part in what is expected.
        inverse = np.linalg.inv(item["intrinsics"][row].numpy())
        u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        slopes = np.stack([u, v, np.ones_like(u)], axis=-1) @ inverse.T
        wanted = 128.0 + STEP * slopes[..., :2]
        shown = item["images"][row, :2, :height, :width].permute(1, 2, 0).numpy().astype(float)
        sure = item["pixel_valid"][row, :height, :width].numpy() & (np.abs(wanted - 128.0) < 90).all(axis=-1)
        assert sure.mean() > 0.4, name
        # Half a pixel of the fisheye is 1.1 levels, and more in smaller images; rounding to levels has a bias of 0.36.
        assert np.abs(shown - wanted)[sure].max() < 1.7, name
        assert np.abs((shown - wanted)[sure].mean(axis=0)).max() < 0.4, name


def opencv_maps(lens: Camera, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    matrix = lens.intrinsic_matrix(first_pixel_centre=0.0)
    size = (lens.width_px, lens.height_px)
    if lens.model == "kannala_brandt":
        return cv2.fisheye.initUndistortRectifyMap(
            matrix, np.array(lens.distortion), np.eye(3), target, size, cv2.CV_32FC1
        )
    return cv2.initUndistortRectifyMap(matrix, np.array(lens.distortion), None, target, size, cv2.CV_32FC1)


@pytest.mark.parametrize("name", ["front_wide", "front_left"])
def test_undistorting_is_opencv_s_for_the_matrix_of_the_sample(first: Dataset, name: str) -> None:
    item = FrameDataset(first, name, undistort=True, layout="hwc")[0]
    assert item["images"].shape == (64, 96, 3) and item["intrinsics"].shape == (3, 3)
    # OpenCV has the first pixel's centre at 0.
    target = item["intrinsics"].numpy() - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
    maps = opencv_maps(LENSES[name], target)
    theirs = cv2.remap(IMAGES[name], *maps, cv2.INTER_LINEAR)
    sure = item["pixel_valid"].numpy()
    assert sure.mean() > 0.5
    assert np.abs(item["images"].numpy()[sure].astype(int) - theirs[sure]).max() <= 1
    known = item["mask_valid"]["instance"]
    assert bool(known) == (name == "front_wide")
    if known:
        # A pixel of the mask is that of the recorded one that its centre falls into.
        nearest = [np.floor(axis + 0.5).astype(int) for axis in maps]
        edge = np.max([np.abs(axis - np.floor(axis) - 0.5) for axis in maps], axis=0) > 1e-3
        expected = INSTANCES[np.clip(nearest[1], 0, 63), np.clip(nearest[0], 0, 95)]
        assert np.array_equal(item["masks"]["instance"].numpy()[sure & edge], expected[sure & edge])
        assert np.array_equal(item["masks"]["dynamic"], item["masks"]["instance"] > 0)


@pytest.mark.parametrize("shape", [(32, 48), (45, 67), (96, 144), (31, 117)])
def test_resized_images_masks_and_intrinsics_follow_the_pixels(first: Dataset, shape: tuple[int, int]) -> None:
    item, frame = FrameDataset(first, resize=shape)[0], first.frames()[0]
    assert item["images"].shape[2:] == shape and bool(item["pixel_valid"].all())
    for row, (name, lens) in enumerate(LENSES.items()):
        across, down = shape[1] / lens.width_px, shape[0] / lens.height_px
        # Corners of pixels stay corners: u' = u width' / width, with centres at + 0.5.
        expected = np.diag([across, down, 1.0]) @ lens.intrinsic_matrix()
        assert np.abs(item["intrinsics"][row].numpy() - expected).max() < 1e-12
        ray = np.array([0.1, -0.2, 1.0])
        uv = lens.project(ray).uv_px * (across, down)
        assert np.abs(camera_of(item, row).project(ray).uv_px - uv).max() < 1e-9
        smaller = across <= 1.0 and down <= 1.0
        theirs = cv2.resize(
            frame.images[name].decode(), shape[::-1], interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
        )
        assert np.array_equal(item["images"][row].permute(1, 2, 0), theirs)
    rows = np.floor((np.arange(shape[0]) + 0.5) * 64 / shape[0]).astype(int)
    columns = np.floor((np.arange(shape[1]) + 0.5) * 96 / shape[1]).astype(int)
    assert np.array_equal(item["masks"]["instance"][0], INSTANCES[np.ix_(rows, columns)])


def test_a_mask_that_is_not_there_is_not_an_empty_one(first: Dataset) -> None:
    samples = FrameDataset(first)
    assert samples.masks == ("dynamic", "ego", "instance")
    item = samples[0]
    assert item["mask_valid"]["dynamic"].tolist() == [True, False, False, False]
    assert item["mask_valid"]["ego"].tolist() == [True, False, False, False]
    assert item["masks"]["ego"].dtype == torch.bool and item["masks"]["instance"].dtype == torch.uint8
    assert np.array_equal(item["masks"]["ego"][0], EGO > 0)
    assert np.array_equal(item["masks"]["instance"][0], INSTANCES)
    assert not samples[1]["mask_valid"]["dynamic"].any() and samples[1]["mask_valid"]["ego"][0]
    chosen = FrameDataset(first, masks=["dynamic/sam@1"])[0]
    assert list(chosen["masks"]) == ["dynamic/sam@1"] and bool(chosen["mask_valid"]["dynamic/sam@1"][0])
    assert FrameDataset(first, masks=[])[0]["masks"] == {}


def test_boxes_are_those_of_the_frame_and_numbered_alike_in_every_view(dataset: Dataset) -> None:
    samples, frames = FrameDataset(dataset), dataset.frames()
    assert samples.categories == ("bus", "car", "van") == FrameDataset(dataset.where(drive="d1")).categories
    for index, count in ((0, 2), (1, 1), (2, 0), (4, 1)):
        item, boxes = samples[index], frames[index].boxes("world")
        assert len(boxes) == count and item["box_valid"].tolist() == [True] * count + [False] * (2 - count)
        assert np.array_equal(item["world_SE3_box"][:count], boxes.pose.matrix())
        assert np.array_equal(item["box_size_m"][:count], boxes.size_m)
        assert np.array_equal(item["box_velocity_mps"][:count], boxes.velocity_mps, equal_nan=True)
        assert np.array_equal(item["box_score"][:count], boxes.score, equal_nan=True)
        names = [samples.categories[number] for number in item["box_category"][:count]]
        assert tuple(names) == boxes.category
        tracks = [frames[index].track_ids[number] for number in item["box_track"][:count]]
        assert tuple(tracks) == boxes.track_id
        assert item["box_category"][count:].tolist() == [-1] * (2 - count)
        assert int(item["box_timestamp_ns"]) == boxes.timestamp_ns
    only = FrameDataset(dataset, categories=["van", "tram"])[0]
    assert only["box_valid"].tolist() == [True, False] and only["box_category"].tolist() == [0, -1]
    assert only["box_track"].tolist() == [1, -1]
    assert not any(key.startswith("box") for key in FrameDataset(dataset, boxes=False)[0])


class Spy(FrameDataset):
    """Says which modules the process has that made a sample."""

    def __getitem__(self, index: int) -> dict[str, object]:
        return {**super().__getitem__(index), "numba": "numba" in sys.modules, "threads": cv2.getNumThreads()}


def equal(one: object, other: object) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(equal(one[key], other[key]) for key in one)
    if isinstance(one, torch.Tensor):
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.is_floating_point())
    return one == other


@pytest.mark.parametrize(("context", "workers"), [("spawn", 2), ("forkserver", 1)])
def test_workers_make_the_same_samples_alone_on_their_thread(dataset: Dataset, context: str, workers: int) -> None:
    options = {"undistort": True, "resize": 0.75}
    alone = FrameDataset(dataset, **options)
    loader = DataLoader(Spy(dataset, **options), batch_size=4, num_workers=workers, multiprocessing_context=context)
    batches = list(loader)
    assert [len(batch["frame_index"]) for batch in batches] == [4, 3]
    for batch, indices in zip(batches, (range(4), range(4, 7))):
        assert not batch.pop("numba").any() and set(batch.pop("threads").tolist()) == {1}
        assert equal(batch, default_collate([alone[index] for index in indices]))
        assert camera_of(batch, 0, 1) == camera_of(alone[indices[0]], 1)


def say_whether_forked() -> None:
    sys.exit(int(is_forked()))


@pytest.mark.skipif(multiprocessing.get_start_method() != "fork", reason="loaders do not fork here")
def test_forked_workers_are_refused(dataset: Dataset) -> None:
    # Forking after OpenCV's threads ran hung now and then.
    loader = DataLoader(IterableFrames(dataset, 2), batch_size=None, num_workers=1)
    with pytest.raises(UsageError, match=r'forked.*multiprocessing_context="spawn"'):
        next(iter(loader))
    for context, forked in (("fork", 1), ("forkserver", 0)):
        process = multiprocessing.get_context(context).Process(target=say_whether_forked)
        process.start()
        process.join(30)
        assert process.exitcode == forked


def test_batches_by_size_are_not_padded_and_have_every_frame_once(dataset: Dataset) -> None:
    frames = IterableFrames(dataset, 2, seed=5, group_by_size=True)
    batches = list(DataLoader(frames, batch_size=None))
    assert len(batches) == len(frames) == 4
    assert [int(batch["step"]) for batch in batches] == list(range(4))
    shapes = [tuple(batch["images"].shape) for batch in batches]
    assert sorted(shapes) == [(1, 4, 3, 32, 48), (2, 4, 3, 32, 48), (2, 4, 3, 64, 96), (2, 4, 3, 64, 96)]
    every = [key for batch in batches for key in zip(batch["traversal_id"], batch["frame_index"].tolist(), strict=True)]
    assert sorted(every) == [(frame.traversal_id, frame.frame_index) for frame in dataset.frames()]


@pytest.mark.parametrize("drop_last", [False, True])
def test_ranks_have_batches_of_one_size_at_each_step(dataset: Dataset, drop_last: bool) -> None:
    options = {"seed": 5, "group_by_size": True, "drop_last": drop_last, "world_size": 2}
    ranks = [IterableFrames(dataset, 1, rank=rank, **options) for rank in range(2)]
    batches = [list(rank) for rank in ranks]
    assert [len(rank) for rank in ranks] == [len(own) for own in batches] == ([3, 3] if drop_last else [4, 3])
    if drop_last:
        for one, other in zip(*batches, strict=True):
            assert one["images"].shape == other["images"].shape
    keys = [(batch["traversal_id"][0], int(batch["frame_index"][0])) for own in batches for batch in own]
    assert len(set(keys)) == len(keys) == (6 if drop_last else 7)


def test_a_state_without_groups_is_not_one_with_them(dataset: Dataset) -> None:
    state = IterableFrames(dataset, 2).state_dict()
    with pytest.raises(UsageError, match="state has group_by_size False"):
        IterableFrames(dataset, 2, group_by_size=True).load_state_dict(state)
    # As older versions wrote it.
    for name in ("group_by_size", "drop_last", "groups"):
        del state[name]
    IterableFrames(dataset, 2).load_state_dict(state)
    IterableFrames(dataset, 2, drop_last=True).load_state_dict(state)


def test_a_state_is_refused_where_other_frames_share_a_batch(dataset: Dataset) -> None:
    grouped = IterableFrames(dataset, 2, group_by_size=True)
    state = json.loads(json.dumps(grouped.state_dict()))
    with pytest.raises(UsageError, match="drop_last False"):
        IterableFrames(dataset, 2, group_by_size=True, drop_last=True).load_state_dict(state)
    # Both drives get images of one size, and so one group; half the size leaves two groups.
    with pytest.raises(UsageError, match="state has groups"):
        IterableFrames(dataset, 2, group_by_size=True, resize=(32, 48)).load_state_dict(state)
    IterableFrames(dataset, 2, group_by_size=True, resize=0.5).load_state_dict(state)


def test_what_cannot_be_is_refused(dataset: Dataset, tmp_path: Path) -> None:
    for options, words in (
        ({"resize": 512}, r"resize=512; expected \(height, width\)"),
        ({"resize": (0, 4)}, "factor"),
        ({"resize": float("nan")}, "factor"),
        ({"layout": "nchw"}, "'chw' or 'hwc'"),
        ({"masks": ["sky"]}, "no masks 'sky' .* dynamic"),
        ({"masks": "ego"}, r"such as \['ego'\]"),
        ({"categories": "car"}, "a list of names"),
        ({"categories": ["car"], "boxes": False}, "boxes=True"),
        ({"cameras": []}, "at least one"),
        ({"cameras": ["rear", "rear"]}, "each once"),
    ):
        with pytest.raises(UsageError, match=words):
            FrameDataset(dataset, **options)
    builder = Builder(tmp_path, cameras=("front_wide",))
    builder.scene("a")
    image = {"front_wide": png(np.zeros((32, 48, 3), np.uint8))}
    (traversal,) = builder.drive("d0", [Pass("a", images=image, codec="png")])
    for name in ("one@1", "two@2"):
        builder.layer(traversal, "boxes", name, BOXES, [])
        folder = builder.layout.layer(traversal, "masks", *name.split("@"))
        write_bytes(folder / "m.png", png(np.zeros((32, 48), np.uint8)))
        uri = (folder / "m.png").relative_to(tmp_path).as_posix()
        source, version = name.split("@")
        row = mask_row("front_wide", EPOCH, uri, png(np.zeros((32, 48), np.uint8)), source=source)
        builder.layer(traversal, "masks", name, MASKS, [{**row, "source_version": version}])
    build_index(tmp_path)
    several = mirror.open(tmp_path)
    with pytest.raises(UsageError, match="one@1, two@2"):
        FrameDataset(several)[0]
    assert FrameDataset(several, masks=["dynamic/two@2"])[0]["mask_valid"]["dynamic/two@2"].all()


def test_a_calibration_of_another_raster_is_refused(tmp_path: Path) -> None:
    builder = Builder(tmp_path, cameras=("front_wide",))
    builder.scene("a")
    image = {"front_wide": png(np.zeros((32, 48, 3), np.uint8))}
    (traversal,) = builder.drive("d0", [Pass("a", images=image, codec="png")])
    builder.layer(traversal, "calibrations", "bad@1", CALIBRATIONS, [calibration("front_wide", 0, (96, 64))])
    build_index(tmp_path)
    view = mirror.open(tmp_path).with_layers(calibrations="bad@1")
    with pytest.raises(DatasetError, match=r"48 x 32 px.*96 x 64 px"):
        FrameDataset(view)[0]


def test_a_mask_of_another_raster_is_refused(tmp_path: Path) -> None:
    builder = Builder(tmp_path, cameras=("front_wide",))
    builder.scene("a")
    builder.drive("d0", [Pass("a", images={"front_wide": png(np.zeros((32, 48, 3), np.uint8))}, codec="png")])
    write_bytes(tmp_path / "rigs" / "m.png", png(EGO))
    builder.write_rig({"front_wide": "m.png"})
    build_index(tmp_path)
    with pytest.raises(DatasetError, match=r"camera front_wide.*48 x 32 px"):
        FrameDataset(mirror.open(tmp_path))[0]
