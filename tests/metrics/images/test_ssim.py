import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from skimage.metrics import structural_similarity

from mirror.errors import UsageError
from mirror.metrics.images.ssim import PRESETS, Ssim, ssim, ssim_map
from mirror.metrics.images.ssim_map import SsimSettings
from tests.draws import draws
from tests.metrics.images.references import ellipse, exact_ssim, street


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(("precision", "error"), [("float64", 1e-12), ("float32", 2e-4)])
def test_the_map_is_the_textbook_s(preset, precision, error):
    render, truth = street(70, 40)
    expected = exact_ssim(render, truth, PRESETS[preset], 255)
    found = ssim_map(render, truth, preset=preset, precision=precision)
    assert found.dtype == precision
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    assert np.nanmax(abs(found - expected)) <= error
    assert ssim(render, truth, preset=preset, precision=precision) == pytest.approx(
        float(np.nanmean(expected)), abs=error
    )


def test_the_map_is_right_where_contrast_is_greatest():
    rng = np.random.default_rng(0)
    render, truth = (rng.integers(0, 2, (40, 40, 1), np.uint8) * np.uint8(255) for _ in range(2))
    render[:15], truth[:15] = 0, 255
    expected = exact_ssim(render, truth, PRESETS["gaussian11"], 255)
    assert np.nanmax(abs(ssim_map(render, truth) - expected)) <= 1e-12


def test_gaussian11_is_scikit_image_with_gaussian_weights():
    render, truth = street()
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "channel_axis": -1}
    expected = structural_similarity(render.astype(float), truth.astype(float), data_range=255, **options)
    assert ssim(render, truth) == pytest.approx(expected, abs=1e-12)
    assert ssim(render / 255, truth / 255, data_range=1.0) == pytest.approx(expected, abs=1e-12)


def test_uniform7_is_scikit_image_s_default():
    render, truth = street()
    expected, full = structural_similarity(render / 255, truth / 255, data_range=1.0, channel_axis=-1, full=True)
    assert ssim(render, truth, preset="uniform7") == pytest.approx(expected, abs=1e-11)
    # DriveStudio indexes the uncropped map, whose border is mirrored.
    mask = ellipse(90, 160, slice(0, 30), slice(0, 50))
    mirrored = replace(PRESETS["uniform7"], border="symmetric")
    assert ssim(render, truth, mask=mask, preset=mirrored) == pytest.approx(full[mask].mean(), abs=1e-11)


def test_torchmetrics_preset_is_torchmetrics():
    torch = pytest.importorskip("torch")
    torchmetrics = pytest.importorskip("torchmetrics.functional.image", exc_type=ImportError)
    render, truth = street()
    batch = [torch.from_numpy(image / 255.0).permute(2, 0, 1)[None] for image in (render, truth)]
    expected = torchmetrics.structural_similarity_index_measure(*batch, data_range=1.0)
    assert ssim(render, truth, preset="torchmetrics") == pytest.approx(float(expected), abs=1e-9)


def test_3dgs_preset_is_a_convolution_with_zero_padding():
    torch = pytest.importorskip("torch")
    render, truth = street()
    line = torch.exp(-((torch.arange(11, dtype=torch.float64) - 5) ** 2) / (2 * 1.5**2))
    window = torch.outer(line, line)[None, None] / line.sum() ** 2

    def blurred(values):
        return torch.nn.functional.conv2d(values, window, padding=5)

    a, b = (torch.from_numpy(image / 255.0).permute(2, 0, 1)[:, None] for image in (render, truth))
    ma, mb = blurred(a), blurred(b)
    va, vb, cov = blurred(a * a) - ma**2, blurred(b * b) - mb**2, blurred(a * b) - ma * mb
    found = (2 * ma * mb + 1e-4) * (2 * cov + 9e-4) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4))
    assert ssim(render, truth, preset="3dgs") == pytest.approx(float(found.mean()), abs=1e-11)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("part", [(slice(30, 50), slice(60, 90)), (slice(0, 12), slice(140, 160))])
def test_a_mask_is_the_whole_map_indexed_at_the_price_of_its_box(preset, part):
    render, truth = street()
    mask = ellipse(90, 160, *part)
    whole = ssim_map(render, truth, preset=preset)[mask]
    assert ssim(render, truth, mask=mask, preset=preset) == pytest.approx(np.nanmean(whole), abs=1e-12)


@pytest.mark.parametrize("preset", PRESETS)
def test_erode_leaves_windows_that_see_beyond_the_mask_out(preset):
    render, truth = street()
    mask = ellipse(90, 160, slice(20, 60), slice(50, 110))
    radius = PRESETS[preset].radius
    inside = np.array(
        [
            [mask[max(y - radius, 0) : y + radius + 1, max(x - radius, 0) : x + radius + 1].all() for x in range(160)]
            for y in range(90)
        ]
    )
    expected = ssim_map(render, truth, preset=preset)[inside].mean()
    found = ssim(render, truth, mask=mask, preset=preset, mask_mode="erode")
    assert found == pytest.approx(expected, abs=1e-12)
    # What is beyond the mask does not matter then.
    render[~mask] = 0
    assert ssim(render, truth, mask=mask, preset=preset, mask_mode="erode") == pytest.approx(found, abs=1e-12)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(("precision", "error"), [("float64", 1e-12), ("float32", 2e-4)])
def test_normalised_windows_see_only_the_mask(preset, precision, error):
    render, truth = street(40, 45)
    mask = ellipse(40, 45, slice(2, 35), slice(5, 45)) & (np.random.default_rng(0).random((40, 45)) < 0.7)
    expected = exact_ssim(render, truth, PRESETS[preset], 255, mask)[mask]
    options = {"preset": preset, "mask_mode": "normalised", "mask": mask, "precision": precision}
    found = ssim(render, truth, **options)
    assert found == pytest.approx(float(np.nanmean(expected)), abs=error)
    floats = [image / 255.0 for image in (render, truth)]
    floats[0][~mask] = np.nan
    assert ssim(*floats, data_range=1.0, **options) == pytest.approx(found, abs=error)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("mask_mode", ["map", "erode", "normalised"])
def test_a_mask_of_everything_changes_nothing(preset, mask_mode):
    render, truth = street()
    mask = np.ones(render.shape[:2], bool)
    assert ssim(render, truth, preset=preset, mask=mask, mask_mode=mask_mode) == pytest.approx(
        ssim(render, truth, preset=preset), abs=1e-12
    )


def test_masks_that_leave_nothing_are_nan_with_a_reason():
    render, truth = street()
    mask = np.zeros(render.shape[:2], bool)
    assert ssim(render, truth, mask=mask).reason == "the mask selects no pixel"
    mask[0, 0] = True
    assert ssim(render, truth, mask=mask).reason == "no selected pixel has its whole window in the image"
    assert not math.isnan(ssim(render, truth, mask=mask, preset="3dgs"))
    mask[20:25, 30:35] = True
    assert (
        ssim(render, truth, mask=mask, mask_mode="erode").reason == "no selected pixel has its whole window in the mask"
    )


@pytest.mark.parametrize("preset", PRESETS)
def test_images_may_be_views_of_any_number_of_channels(preset):
    render, truth = street()
    views = [np.concatenate([image, image[..., ::-1]], axis=2)[::-1, ::2] for image in (render, truth)]
    copies = [image[:, ::2].copy() for image in (render, truth)]
    assert ssim(*views, preset=preset) == pytest.approx(ssim(*copies, preset=preset), abs=1e-12)


def test_a_mask_of_one_pixel():
    render, truth = street()
    mask = np.zeros(render.shape[:2], bool)
    mask[40, 50] = True
    assert ssim(render, truth, mask=mask) == pytest.approx(ssim_map(render, truth)[40, 50].mean(), abs=1e-12)
    # A window that sees one pixel has no variance: luminance alone is compared.
    a, b = render[40, 50].astype(float), truth[40, 50].astype(float)
    luminance = (2 * a * b + 2.55**2) / (a * a + b * b + 2.55**2)
    for preset in PRESETS:
        found = ssim(render, truth, mask=mask, mask_mode="normalised", preset=preset)
        assert found == pytest.approx(luminance.mean(), abs=1e-12)


@settings(max_examples=draws(30), deadline=None)
@given(st.data())
def test_one_for_equal_images_and_never_more(data):
    dtype = data.draw(st.sampled_from([np.uint8, np.float32, np.float64]))
    elements = st.integers(0, 255) if dtype == np.uint8 else st.floats(0, 1, width=32)
    shape = (data.draw(st.integers(11, 14)), data.draw(st.integers(11, 14)), data.draw(st.sampled_from([1, 3])))
    render, truth = (data.draw(hnp.arrays(dtype, shape, elements=elements)) for _ in range(2))
    options = {
        "preset": data.draw(st.sampled_from(sorted(PRESETS))),
        "precision": data.draw(st.sampled_from(["float64", "float32"])),
        "data_range": None if dtype == np.uint8 else 1.0,
    }
    assert ssim(truth, truth, **options) == 1.0
    found = ssim_map(render, truth, **options)
    assert np.nanmax(found) <= 1.0
    assert np.nanmin(found) >= -1.0 - 1e-6
    swapped = ssim_map(truth, render, **options)
    assert np.nanmax(abs(found - swapped)) <= (1e-11 if options["precision"] == "float64" else 1e-3)


@pytest.mark.parametrize("offset", [1e2, 1e4, 1e6, 1e8])
@pytest.mark.parametrize(("precision", "error"), [("float64", 1e-12), ("float32", 2e-4)])
def test_offsets(offset, precision, error):
    rng = np.random.default_rng(0)
    truth, render = (np.rint(rng.random((20, 24, 3)) * 2**20) / 2**20 + offset for _ in range(2))
    found = ssim_map(render, truth, data_range=1.0, precision=precision)
    assert np.nanmax(abs(found - exact_ssim(render, truth, PRESETS["gaussian11"], 1))) <= error


def test_flat_tiny_and_saturated_images():
    flat = np.full((20, 20), 0.6)
    for precision, error in (("float64", 1e-15), ("float32", 1e-7)):
        found = ssim(flat, flat + 1e-7, data_range=1.0, precision=precision)
        assert found <= 1.0
        assert found == pytest.approx(1 - 1e-14 / (0.36 * 2 + 1e-4), abs=error)
    render, truth = street(20, 20)
    tiny = [image * 2.0**-150 for image in (render, truth)]
    assert ssim(*tiny, data_range=255 * 2.0**-150) == pytest.approx(ssim(render, truth), abs=1e-12)
    black, white = np.zeros((20, 20), np.uint8), np.full((20, 20), 255, np.uint8)
    assert ssim(black, white) == pytest.approx(1e-4 / (1 + 1e-4), abs=1e-12)


def test_the_smallest_images():
    render, truth = street(11, 11)
    assert ssim(render, truth) == pytest.approx(ssim_map(render, truth)[5, 5].mean(), abs=1e-15)
    with pytest.raises(UsageError, match="an image of 11 x 10 px"):
        ssim(render[:10], truth[:10])
    one = render[:1, :1], truth[:1, :1]
    for preset in ("torchmetrics", "3dgs"):
        assert ssim(*one, preset=preset) <= 1.0
    assert ssim_map(render[..., 0], truth[..., 0]).shape == (11, 11)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_pixels_that_are_not_finite_are_named(bad):
    truth = np.random.default_rng(0).random((30, 30, 3))
    render = truth.copy()
    render[3, 4, 1] = bad
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for call in (ssim, ssim_map):
            with pytest.raises(UsageError, match="render, first at row 3, column 4, channel 1"):
                call(render, truth, data_range=1.0)
        mask = np.zeros((30, 30), bool)
        mask[15:, 15:] = True
        assert ssim(render, truth, mask=mask, data_range=1.0) == 1.0
        mask[:] = True
        mask[3, 4] = False
        assert ssim(render, truth, mask=mask, mask_mode="normalised", data_range=1.0) == 1.0


def test_what_has_no_meaning_is_refused():
    render, truth = street(20, 20)
    for options, problem in (
        ({"preset": "gaussian"}, "one of gaussian11, uniform7, torchmetrics, 3dgs"),
        ({"mask_mode": "zero"}, "one of map, erode, normalised"),
        ({"precision": "float16"}, "float64 or float32"),
    ):
        with pytest.raises(UsageError, match=problem):
            ssim(render, truth, **options)
    with pytest.raises(UsageError, match="take float64"):
        ssim(render / 255 * 1e-20, truth / 255 * 1e-20, data_range=1e-20, precision="float32")
    with pytest.raises(UsageError, match="too large"):
        ssim(np.full((20, 20), 1e200), np.eye(20), data_range=1.0)
    for wrong in (
        {"size": 4},
        {"sigma_px": 0.0},
        {"border": "wrap"},
        {"window": "box"},
        {"sample_covariance": True},
    ):
        with pytest.raises(UsageError):
            SsimSettings(**{"window": "gaussian", "size": 11, "sigma_px": 1.5, "border": "valid"} | wrong)


def test_many_images():
    render, truth = street()
    first, second = Ssim("uniform7"), Ssim("uniform7")
    scores = [first.update(render, truth), second.update(truth, truth)]
    second.update(render, truth, np.zeros(truth.shape[:2], bool))
    first.merge(second)
    summary = first.compute()
    assert summary.mean == pytest.approx(sum(scores) / 2, abs=1e-15)
    assert (summary.n, summary.n_finite, summary.n_nan) == (3, 2, 1)
    with pytest.raises(UsageError, match="one definition"):
        first.merge(Ssim())
