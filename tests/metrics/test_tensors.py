"""Metrics take torch tensors: the same bits as of arrays, and a named error for all that is neither."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.geometry.poses import Poses
from mirror.metrics.boxes.iou_2d import box_iou_2d, hull_iou, mask_iou
from mirror.metrics.boxes.iou_3d import box_iou_3d
from mirror.metrics.boxes.projected import polygon_area
from mirror.metrics.detection import DetectionBoxes
from mirror.metrics.features.frechet import frechet_distance
from mirror.metrics.features.kid import kid
from mirror.metrics.images.bootstrap import mean_interval
from mirror.metrics.images.colour_correction import correct_colours, psnr_cc
from mirror.metrics.images.psnr import Psnr, psnr
from mirror.metrics.images.ssim import Ssim, ssim, ssim_map

torch = pytest.importorskip("torch")
from mirror.metrics.features.fvd import VideoFeatures, fvd  # noqa: E402
from mirror.metrics.features.lpips import lpips  # noqa: E402
from mirror.metrics.features.perceptual import PerceptualDistance, filled  # noqa: E402
from mirror.metrics.features.st_lpips import st_lpips  # noqa: E402
from tests.metrics.networks.trunk_states import random_state, trunk  # noqa: E402

SHAPE = (3, 47, 64, 3)


def images(dtype: str = "uint8") -> tuple[np.ndarray, np.ndarray]:
    """Renders and truths (N, H, W, C)."""
    draw = np.random.default_rng(5)
    truth = draw.random(SHAPE)
    render = np.clip(truth + 0.1 * draw.standard_normal(SHAPE), 0.0, 1.0)
    if dtype == "uint8":
        return tuple((255 * image).astype(np.uint8) for image in (render, truth))
    return render.astype(dtype), truth.astype(dtype)


def in_layout(batch: np.ndarray, layout: str) -> Any:
    """A tensor of the first image, or of all, with strides of its own."""
    tensor = torch.from_numpy(batch).permute(0, 3, 1, 2) if layout.endswith("chw") else torch.from_numpy(batch)
    return tensor if layout.startswith("n") else tensor[0]


MASK = np.ones(SHAPE[:3], np.bool_)
for number in range(SHAPE[0]):
    MASK[number, 5 : 20 + number, 10 + 3 * number : 30] = False
METRICS = {
    "psnr": psnr,
    "ssim": ssim,
    "ssim uniform7": lambda *pair, **options: ssim(*pair, preset="uniform7", mask_mode="erode", **options),
    "psnr_cc": lambda *pair, **options: psnr_cc(*pair, **options),
}


@pytest.mark.parametrize("dtype", ["uint8", "float32", "float64"])
@pytest.mark.parametrize("layout", ["hwc", "chw", "nhwc", "nchw"])
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("name", list(METRICS))
def test_tensors_score_the_bits_of_arrays(name: str, layout: str, dtype: str, masked: bool) -> None:
    metric, options = METRICS[name], {} if dtype == "uint8" else {"data_range": 1.0}
    render, truth = images(dtype)
    alone = [
        metric(one, other, mask=own if masked else None, **options) for one, other, own in zip(render, truth, MASK)
    ]
    assert len(set(map(repr, alone))) == 3
    batch = layout.startswith("n")
    expected = alone if batch else alone[0]
    mask = None if not masked else torch.from_numpy(MASK if batch else MASK[0])
    tensors = in_layout(render, layout), in_layout(truth, layout)
    assert metric(*tensors, mask=mask, layout=layout, **options) == expected
    # One of each, and arrays in the same layout.
    arrays = [tensor.contiguous().numpy() for tensor in tensors]
    assert metric(tensors[0], arrays[1], mask=mask, layout=layout, **options) == expected
    assert metric(*arrays, mask=mask, layout=layout, **options) == expected


def test_one_mask_for_a_batch_and_grey_images() -> None:
    render, truth = (batch[..., 0].copy() for batch in images())
    expected = [psnr(one, other, mask=MASK[0]) for one, other in zip(render, truth)]
    tensors = torch.from_numpy(render), torch.from_numpy(truth)
    assert psnr(*tensors, mask=torch.from_numpy(MASK[0]), layout="nhw") == expected
    assert psnr(tensors[0][1], tensors[1][1]) == psnr(render[1], truth[1])
    assert psnr(tensors[0][:0], tensors[1][:0], layout="nhw") == []


def test_maps_corrections_and_accumulators() -> None:
    render, truth = images()
    first, second = in_layout(render, "chw"), in_layout(truth, "chw")
    assert np.array_equal(ssim_map(first, second, layout="chw"), ssim_map(render[0], truth[0]), equal_nan=True)
    mask = torch.from_numpy(MASK[0])
    warped = correct_colours(first, second, mask=mask, layout="chw")
    assert np.array_equal(warped.colours, correct_colours(render[0], truth[0], mask=MASK[0]).colours)
    batch = in_layout(render, "nchw"), in_layout(truth, "nchw")
    for kind in (Psnr, Ssim):
        one, other = kind(), kind()
        added = one.update(*batch, torch.from_numpy(MASK), layout="nchw")
        assert added == [other.update(a, b, c) for a, b, c in zip(render, truth, MASK)]
        assert one.compute() == other.compute()
        broken = [tensor.double() for tensor in batch]
        broken[0][2, 0, 3, 3] = torch.nan
        one = kind(data_range=255.0)
        with pytest.raises(UsageError, match="render, first at row 3, column 3, channel 0"):
            one.update(*broken, layout="nchw")
        assert one.scores == []


def test_networks_take_tensors() -> None:
    network = trunk("alex")
    heads = [torch.rand(channels, generator=torch.Generator().manual_seed(3)) for channels in network.channels]
    model = PerceptualDistance("smoke", filled(network, random_state(network)), heads)
    render, truth = (np.repeat(batch, 2, axis=1) for batch in images())
    expected = [model([one], other)[0] for one, other in zip(render, truth)]
    assert len(set(expected)) == 3 and min(expected) > 0.0
    assert model(in_layout(render, "nchw")[:1], in_layout(truth, "chw"), layout="chw") == expected[:1]
    for name, function in (("lpips-smoke", lpips), ("st_lpips-smoke", st_lpips)):
        model.name = name
        for layout in ("nchw", "nhwc", "chw", "hwc"):
            found = function(in_layout(render, layout), in_layout(truth, layout), model, layout=layout)
            assert found == (expected if layout.startswith("n") else expected[0])
    with pytest.raises(UsageError, match="has no layout"):
        model([in_layout(render, "chw")], in_layout(truth, "chw"))


def test_clips_are_tensors_of_either_layout() -> None:
    clips = np.random.default_rng(2).integers(0, 256, (8, 9, 12, 16, 3), np.uint8)

    def means(clips: Any) -> Any:
        return clips.mean(dim=(2, 3, 4)) + clips[:, :, 0].std(dim=(2, 3))

    extractor = VideoFeatures(means, name="smoke")
    expected = fvd(clips[:4], clips[4:], extractor).value
    assert expected > 0.0
    tensors = [torch.from_numpy(clip).permute(0, 3, 1, 2) for clip in clips]
    assert fvd(tensors[:4], tensors[4:], extractor, layout="nchw").value == expected
    with pytest.raises(UsageError, match="a clip of shape"):
        fvd(tensors[:4], tensors[4:], extractor)


def test_features_boxes_and_scores_are_tensors_too() -> None:
    draw = np.random.default_rng(3)
    first, second = draw.standard_normal((40, 6)), draw.standard_normal((30, 6))
    features = torch.from_numpy(first), torch.from_numpy(second)
    assert frechet_distance(*features) == frechet_distance(first, second)
    assert kid(*features) == kid(first, second)
    boxes = np.sort(draw.random((2, 5, 2, 2)), axis=2).reshape(2, 5, 4)
    assert np.array_equal(box_iou_2d(*torch.from_numpy(boxes)), box_iou_2d(*boxes))
    masks = torch.from_numpy(MASK)
    assert mask_iou(masks[0], masks[1], valid=masks[2]) == mask_iou(MASK[0], MASK[1], valid=MASK[2])
    hull = np.array([[3.0, 4.0], [30.0, 6.0], [20.0, 40.0]])
    assert hull_iou(masks[0], torch.from_numpy(hull)) == hull_iou(MASK[0], hull)
    assert polygon_area(torch.from_numpy(hull)) == polygon_area(hull)
    poses, sizes = Poses([[1, 0, 0, 0]] * 2, [[0.0, 0, 0], [1.0, 0, 0]]), np.array([[4.0, 2, 1], [3.0, 2, 2]])
    found = box_iou_3d(poses[:1], torch.from_numpy(sizes[:1]), poses[1:], torch.from_numpy(sizes[1:]))
    assert np.array_equal(found, box_iou_3d(poses[:1], sizes[:1], poses[1:], sizes[1:]))
    of_tensors = DetectionBoxes.from_poses(
        ["a"] * 2, ["car"] * 2, poses, torch.from_numpy(sizes), velocity_mps=torch.ones(2, 2), score=torch.ones(2)
    )
    assert np.array_equal(of_tensors.lwh_m, sizes) and of_tensors.score.dtype == np.float64
    scores = draw.random(20)
    assert mean_interval(torch.from_numpy(scores), range(20)) == mean_interval(scores, range(20))
    for call in (
        lambda bad: box_iou_2d(bad, bad),
        lambda bad: frechet_distance(bad, bad),
        lambda bad: polygon_area(bad),
        lambda bad: mask_iou(bad, bad),
        lambda bad: mean_interval(bad, range(4)),
    ):
        for bad in (torch.ones(4, 4, requires_grad=True), torch.ones(4, 4, device="meta"), "boxes", [[object()]]):
            with pytest.raises(UsageError):
                call(bad)


CHW = torch.zeros(3, 47, 64)


@pytest.mark.parametrize(
    ("given", "layout", "words"),
    [
        ([[1.0, 2.0]], None, r"render is a builtins.list; expected a numpy array or a torch tensor"),
        ("render.png", None, "builtins.str"),
        (None, None, "builtins.NoneType"),
        (np.ma.zeros((4, 4)), None, "masked array"),
        (CHW, None, r"a tensor of shape \(3, 47, 64\) and has no layout; .*'hwc', 'chw', 'nhw'"),
        (CHW[None], None, r"a batch of shape \(1, 3, 47, 64\) and has no layout; .*'nhwc', 'nchw'"),
        (np.zeros((2, 47, 64, 3)), None, "a batch"),
        (CHW, "hwc", "64 channels by layout='hwc'.* 1 to 4"),
        (CHW.permute(1, 2, 0), "chw", "47 channels"),
        (CHW, "nchw", "expected 4 axes: layout='nchw'"),
        (CHW, "bchw", "layout='bchw'; expected one of 'hw'"),
        (CHW.requires_grad_(False).clone().requires_grad_(), "chw", r"requires a gradient.*\.detach\(\)"),
        (CHW.to("meta"), "chw", r"a tensor on meta; .*\.cpu\(\)"),
        (CHW.bfloat16(), "chw", r"torch.bfloat16 .*\.float\(\)"),
        (CHW.to_sparse(), "chw", r"torch.sparse_coo"),
        (CHW.half(), "chw", "render of float16"),
        (torch.complex(CHW, CHW).conj(), "chw", "render of complex64"),
    ],
)
def test_all_else_is_refused_by_name(given: Any, layout: Any, words: str) -> None:
    for metric in (psnr, ssim, psnr_cc):
        with pytest.raises(UsageError, match=words):
            metric(given, given, layout=layout, data_range=1.0)
    with pytest.raises(UsageError):
        Psnr(1.0).update(given, given, layout=layout)


def test_what_does_not_fit_a_batch_is_refused() -> None:
    batch = in_layout(images()[0], "nchw")
    with pytest.raises(UsageError, match="3 renders and 2 truths"):
        psnr(batch, batch[:2], layout="nchw")
    with pytest.raises(UsageError, match=r"mask of shape \(2, 47, 64\) for 3 images"):
        ssim(batch, batch, mask=torch.from_numpy(MASK[:2]), layout="nchw")
    with pytest.raises(UsageError, match="mask is a tensor on meta"):
        ssim(batch, batch, mask=torch.from_numpy(MASK).to("meta"), layout="nchw")
    with pytest.raises(UsageError, match="one image: 'hw'"):
        ssim_map(batch, batch, layout="nchw")


def test_arrays_do_not_import_torch() -> None:
    code = """
import sys
import numpy as np
from mirror.metrics.boxes.iou_2d import box_iou_2d
from mirror.metrics.images.psnr import psnr
from mirror.metrics.images.colour_correction import psnr_cc
import mirror.metrics.images.ssim, mirror.metrics.features.lpips, mirror.metrics.features.frechet
image = np.zeros((2, 3, 8, 8), np.uint8)
psnr(image, image, layout="nchw"), box_iou_2d([0, 0, 1, 1], [0, 0, 1, 1])
try:
    psnr([1], [1])
except mirror.errors.UsageError:
    print("torch" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
