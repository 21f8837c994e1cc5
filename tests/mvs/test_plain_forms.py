"""Plane sweep, fusion and sky in plain torch: as the compiled kernels and OpenCV, on any device, at full size."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import mirror
from hybridworldsim.kernels.dispatch import plain_torch
from hybridworldsim.mvs.estimator import DepthMap, StereoImage
from hybridworldsim.mvs.fusion import PosedDepth, confirm
from hybridworldsim.mvs.images.pairs import choose_sources
from hybridworldsim.mvs.images.posed_images import StereoImageCache, list_posed_images
from hybridworldsim.mvs.methods import make_estimator
from hybridworldsim.mvs.options import InitialisationOptions
from hybridworldsim.mvs.plain import sky as plain_sky
from hybridworldsim.mvs.plain import sweep as plain_sweep
from hybridworldsim.mvs.plain.fusion import OtherDepth, find_agreeing
from hybridworldsim.mvs.plane_sweep import PlaneSweep, to_grey
from hybridworldsim.mvs.run import initialise
from hybridworldsim.mvs.sky import find_sky
from hybridworldsim.mvs.sweep.correlation import UNKNOWN, compute_cost_volume
from hybridworldsim.mvs.sweep.path_costs import select_depths, smooth_costs
from hybridworldsim.mvs.sweep.planes import make_facing_planes, make_road_planes
from mirror.dataset.dataset import Dataset
from mirror.geometry.poses import Poses
from mirror.protocols.document import Pixels
from tests.mvs.images import SIZE, Wall, make_image
from tests.mvs.level_road import LevelRoad
from tests.mvs.street_image import UNKNOWN_DEPTH, make_street_image
from tests.training.shadow import DEVICE, OnShadows

WIDTH_PX, HEIGHT_PX, PLANES, ROAD_PLANES, SOURCES = 960, 540, 128, 32, 4
X_M = (-1.0, 1.0, 0.5, -0.5)
SMOOTHING = {"step": 8, "jump": 48, "neutral": 100, "contrast": 0.05}


def require_equal(one: DepthMap, other: DepthMap) -> None:
    """The bars of docs/initialisation/accuracy.md: 99.9 % of the pixels are known in both or none, and within 1e-3."""
    known = np.isfinite(one.depth_m)
    assert known.mean() > 0.0 and (known == np.isfinite(other.depth_m)).mean() >= 0.999
    both = known & np.isfinite(other.depth_m)
    share = np.abs(one.depth_m - other.depth_m)[both] / one.depth_m[both]
    assert (share <= 1e-3).mean() >= 0.999 and np.median(share) <= 1e-6
    assert (np.abs(one.confidence - other.confidence)[both] <= 0.02).mean() >= 0.999


def make_sources(reference: Wall, valid: np.ndarray) -> list[StereoImage]:
    """Sources of two sizes, one of them masked."""
    whole = [make_image(reference, x) for x in X_M]
    cut = whole[2]
    whole[2] = StereoImage(cut.rgb[:-5, :-9], cut.K, cut.world_SE3_camera, cut.valid[:-5, :-9])
    whole[0] = make_image(reference, X_M[0], valid=valid)
    return whole


@pytest.mark.parametrize("wall", [Wall(), Wall((0.3, 0.0, 0.95), 9.0), Wall((0.0, 0.35, 0.93), 7.0, seed=3)])
@pytest.mark.parametrize("chunk", [1, plain_sweep._CHUNK])
def test_the_sweep_agrees_with_the_kernels(wall: Wall, chunk: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plain_sweep, "_CHUNK", chunk)
    valid = np.ones(SIZE[::-1], np.bool_)
    valid[10:20, 30:44] = False
    reference, sources = make_image(wall, 0.0, valid=valid), make_sources(wall, valid)
    sweep = PlaneSweep(planes=64, road_planes=8, upright_planes=4)
    compiled = sweep(reference, sources, 2.0, 50.0)
    with plain_torch():
        plain = sweep(reference, sources, 2.0, 50.0)
    require_equal(compiled, plain)


def test_costs_sums_and_depths_agree_with_the_kernels() -> None:
    """Costs within a step of 254; the smoothing of equal costs, and the choice of equal sums, are exact."""
    wall = Wall((0.2, 0.1, 0.95), 8.0)
    reference, source = make_image(wall, 0.0), make_image(wall, 0.7)
    planes = make_facing_planes(24, 4.0, 20.0)
    grey, greys = to_grey(reference), [to_grey(source)]
    homographies = planes.compute_homographies(reference, source)[None]
    inverse = planes.compute_inverse_depth(reference.K)
    options = {"best": 1, "deviation": 0.008}
    compiled = compute_cost_volume(grey, greys, homographies, inverse, (1 / 20.0, 1 / 4.0), 24, **options)
    tensors = [torch.from_numpy(np.ascontiguousarray(one)) for one in (grey, *greys, homographies, inverse, compiled)]
    plain = plain_sweep.compute_cost_volume(
        tensors[0], tensors[1:2], tensors[2], tensors[3], (1 / 20.0, 1 / 4.0), 24, **options
    ).numpy()
    known = compiled != UNKNOWN
    assert known.mean() > 0.5 and (known == (plain != UNKNOWN)).mean() > 0.999
    assert np.abs(compiled.astype(int) - plain)[known & (plain != UNKNOWN)].max() <= 1
    total = smooth_costs(compiled, grey, **SMOOTHING)
    sums = plain_sweep.smooth_costs(tensors[4], tensors[0], **SMOOTHING)
    np.testing.assert_array_equal(sums.numpy(), total)
    valid = np.random.default_rng(0).random(grey.shape) < 0.9
    expected = select_depths(compiled, total, valid, 1 / 20.0, 1 / 4.0, 76.0, 25.0)
    found = plain_sweep.select_depths(tensors[4], sums, torch.from_numpy(valid), 1 / 20.0, 1 / 4.0, 76.0, 25.0)
    for one, other in zip(expected, found, strict=True):
        np.testing.assert_allclose(other.numpy(), one, rtol=1e-6)


@pytest.mark.parametrize("case", ["flat", "same place", "all masked", "sources masked", "tiny"])
def test_no_depth_without_evidence(case: str) -> None:
    wall, nowhere = Wall(), np.zeros(SIZE[::-1], np.bool_)
    reference, sources = make_image(wall, 0.0), [make_image(wall, x) for x in X_M]
    if case == "flat":
        sources = [StereoImage(np.full_like(one.rgb, 90), one.K, one.world_SE3_camera, one.valid) for one in sources]
    elif case == "same place":
        sources = [reference, reference]
    elif case == "all masked":
        reference = make_image(wall, 0.0, valid=nowhere)
    elif case == "sources masked":
        sources = [make_image(wall, x, valid=nowhere) for x in X_M]
    else:
        reference = StereoImage(
            np.full((3, 2, 3), 9, np.uint8), reference.K, Poses.identity(), np.ones((3, 2), np.bool_)
        )
        sources = [reference]
    with plain_torch():
        result = PlaneSweep(planes=16)(reference, sources, 2.0, 50.0)
    assert np.isnan(result.depth_m).all() and not result.confidence.any()


def test_images_of_a_street_agree(tiny_dataset: Dataset) -> None:
    """Sweep, fusion and sky of a synthetic street: with masks, occlusions and all kinds of planes."""
    pixels = Pixels(space="undistorted", max_width_px=96)
    posed = list_posed_images(tiny_dataset, pixels)[:12]
    images = StereoImageCache(posed, pixels)
    chosen = choose_sources(posed, SOURCES)
    sweep, depths = PlaneSweep(planes=48, road_planes=16), []
    for number in range(4):
        sources = [images[other] for other in chosen[number].tolist()]
        compiled = sweep(images[number], sources, 2.0, 100.0)
        with plain_torch():
            require_equal(compiled, sweep(images[number], sources, 2.0, 100.0))
        image = images[number]
        depths.append(PosedDepth(compiled.depth_m, image.K, image.world_SE3_camera))
        mask = find_sky(image, compiled.depth_m)
        with plain_torch():
            plain = find_sky(image, compiled.depth_m)
        assert (mask == plain).mean() >= 0.99
    compiled, plain = confirm(depths[0], depths[1:], max_share=0.02), None
    with plain_torch():
        plain = confirm(depths[0], depths[1:], max_share=0.02)
    assert compiled.views.max() >= 2
    np.testing.assert_array_equal(plain.views, compiled.views)
    np.testing.assert_allclose(plain.depth_m, compiled.depth_m, rtol=1e-6)
    np.testing.assert_allclose(plain.spread_m, compiled.spread_m, atol=1e-6)


@pytest.mark.parametrize("sky", [(200, 215, 235), (225, 225, 225), (20, 24, 48), (235, 180, 150)])
def test_masks_of_the_sky_agree(sky: tuple[int, int, int]) -> None:
    image, truth = make_street_image(sky, (90, 80, 70))
    valid = np.ones(truth.shape, np.bool_)
    valid[:4, 30:50] = valid[:, :3] = False
    for one in (image, StereoImage(image.rgb, image.K, image.world_SE3_camera, valid)):
        mask = find_sky(one, UNKNOWN_DEPTH)
        with plain_torch():
            plain = find_sky(one, UNKNOWN_DEPTH)
        assert (mask & truth).sum() > 0.8 * truth.sum() and (mask != plain).mean() <= 0.005


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (3, 2), (60, 80)])
def test_images_without_a_sky_have_none(size: tuple[int, int]) -> None:
    """The image is all road, or all masked; tiny images are mirrored many times at their border."""
    image, _ = make_street_image((200, 215, 235), (90, 80, 70))
    rgb, unknown = np.ascontiguousarray(image.rgb[-size[0] :, -size[1] :]), np.full(size, np.nan, np.float32)
    down = Poses.from_matrix(np.diag([1.0, -1.0, -1.0, 1.0]))
    for pose, valid in ((down, np.ones(size, np.bool_)), (image.world_SE3_camera, np.zeros(size, np.bool_))):
        with plain_torch():
            assert not find_sky(StereoImage(rgb, image.K, pose, valid), unknown).any()


def test_colours_and_connected_parts_are_those_of_opencv() -> None:
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (64, 64, 3), dtype=np.uint8)
    lab = cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB).astype(np.float32)
    # OpenCV computes 8-bit colours by tables of integers.
    assert np.abs(lab - plain_sky.to_lab(torch.from_numpy(rgb)).numpy()).max() <= 2.0
    spiral = np.ones((31, 31), np.bool_)
    for ring in range(1, 15, 2):
        spiral[ring, ring - (ring > 1) : -ring] = spiral[ring:-ring, -ring - 1] = False
        spiral[-ring - 1, ring:-ring] = spiral[ring + 2 : -ring, ring] = False
    for mask in (spiral, rng.random((40, 57)) < 0.55, rng.random((5, 400)) < 0.6, np.zeros((4, 4), np.bool_)):
        for connectivity, steps in ((4, plain_sky._BESIDE), (8, plain_sky._AROUND)):
            _, expected = cv2.connectedComponents(mask.astype(np.uint8), connectivity=connectivity)
            found = plain_sky.label_parts(torch.from_numpy(mask), steps).numpy()
            assert (found[~mask] == mask.size).all()
            # Equal parts: a label of one belongs to one label of the other.
            pairs = np.unique(np.stack((expected[mask], found[mask])), axis=1)
            assert len(np.unique(pairs[0])) == len(np.unique(pairs[1])) == pairs.shape[1]


def test_depth_and_sky_are_found_on_a_device_without_mixing_devices(
    dataset: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On a stand-in for a GPU; the numbers are those of the CPU's kernels, up to the bars above."""
    wall, options = Wall((0.3, 0.0, 0.95), 9.0), {"planes": 24, "road_planes": 4}
    reference, sources = make_image(wall, 0.0), [make_image(wall, x) for x in X_M]
    with OnShadows():
        there = PlaneSweep(**options, device=DEVICE)(reference, sources, 2.0, 50.0)
    require_equal(PlaneSweep(**options)(reference, sources, 2.0, 50.0), there)
    # The stand-in states no memory.
    monkeypatch.setattr("hybridworldsim.mvs.run.require_memory", lambda *_: None)
    layers = {}
    for version, device in (("here", "cpu"), ("there", DEVICE)):
        with OnShadows() if device == DEVICE else nullcontext():
            report = initialise(
                mirror.open(dataset), "s", method="road", estimator=LevelRoad(), version=version, device=device,
                options=InitialisationOptions(width_px=48, held_against=3),
            )  # fmt: skip
        assert report.images == 20
        view = mirror.open(dataset).where(split="s", role="train").with_layers(depth=f"road@{version}")
        shown = [image for frame in view.frames() for image in frame.images.values()]
        depths = [depth.decode() for one in shown if (depth := one.depth()) is not None]
        masks = [mask.decode() > 0 for one in shown for mask in one.masks() if mask.source_version == version]
        layers[version] = depths, masks
    for one, other in zip(*layers.values(), strict=True):
        assert len(one) == len(other) == 20
        for here, elsewhere in zip(one, other, strict=True):
            np.testing.assert_allclose(elsewhere, here, rtol=1e-3)


def test_the_plane_sweep_of_a_device_has_the_name_of_the_cpus() -> None:
    """Its layers are reused, whatever the device: they differ in the last digits only."""
    sweep = make_estimator("plane-sweep", None, "cuda:0")
    assert sweep.device == "cuda:0" and repr(sweep) == repr(PlaneSweep())  # type: ignore[attr-defined]


@pytest.mark.parametrize("device", ["meta", pytest.param("cuda", marks=pytest.mark.cuda)])
def test_depth_of_full_size_computes_on_any_device(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """960 x 540, 160 planes, four sources, and eight other depth maps: shapes do not depend on numbers."""
    if device == "meta":
        monkeypatch.setattr(plain_sweep, "_CHUNK", 1 << 40)
    size = HEIGHT_PX, WIDTH_PX
    grey = torch.zeros(size, device=device)
    pose = Poses.from_matrix(np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]]))
    planes = [make_facing_planes(PLANES, 2.0, 200.0), make_road_planes(ROAD_PLANES, pose)]
    K = torch.tensor([[576.0, 0.0, 480.0], [0.0, 576.0, 270.0], [0.0, 0.0, 1.0]])
    inverse = torch.from_numpy(np.concatenate([one.compute_inverse_depth(K.numpy()) for one in planes])).to(device)
    homographies = torch.eye(3, dtype=torch.float64, device=device).expand(SOURCES, len(inverse), 3, 3)
    options = {"best": 2, "deviation": 0.008}
    volume = plain_sweep.compute_cost_volume(
        grey, [grey] * SOURCES, homographies, inverse, (1 / 200.0, 0.5), PLANES, **options
    )
    total = plain_sweep.smooth_costs(volume, grey, **SMOOTHING)
    depth, confidence = plain_sweep.select_depths(volume, total, grey == 0.0, 1 / 200.0, 0.5, 76.0, 25.0)
    matrix, shift = K.double().to(device), torch.zeros(3, dtype=torch.float64, device=device)
    agreeing = find_agreeing(depth, OtherDepth(depth, matrix, shift, matrix, shift), 1.0, 0.02)
    for found in (depth, confidence, agreeing):
        assert found.shape == size and found.device.type == device
    assert volume.shape == total.shape == (*size, PLANES)
