import numpy as np
import pytest
import torch

from mirror.metrics.networks.resize import resize_clean, resize_tf1, resize_video


def image(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3)).astype(np.float32)


def tensor(pixels):
    return torch.from_numpy(pixels).permute(2, 0, 1)[None]


@pytest.mark.parametrize(("height", "width"), [(54, 96), (20, 31), (17, 17), (1, 5)])
def test_clean_is_pillows(height, width):
    """clean-fid resizes each channel as float with Pillow's bicubic filter, then clips."""
    pillow = pytest.importorskip("PIL.Image")
    pixels = image(height, width)
    channels = [
        pillow.fromarray(np.ascontiguousarray(pixels[..., c])).resize((29, 29), pillow.BICUBIC) for c in range(3)
    ]
    truth = np.clip(np.stack([np.asarray(channel) for channel in channels], axis=2), 0, 255)
    got = resize_clean(tensor(pixels), 29)[0].permute(1, 2, 0).numpy()
    assert np.abs(got - truth).max() < 0.02
    assert np.abs(got - truth).mean() < 0.002


@pytest.mark.parametrize(("height", "width", "size"), [(54, 96, 29), (5, 7, 29), (29, 29, 29), (1, 1, 3)])
def test_tf1_by_its_definition(height, width, size):
    pixels = image(height, width).astype(np.float64)
    truth = np.empty((size, size, 3))
    for row in range(size):
        for column in range(size):
            y, x = np.float32(row) * np.float32(height / size), np.float32(column) * np.float32(width / size)
            top, left = int(y), int(x)
            bottom, right = min(top + 1, height - 1), min(left + 1, width - 1)
            a, b = float(y) - top, float(x) - left
            above = pixels[top, left] * (1 - b) + pixels[top, right] * b
            below = pixels[bottom, left] * (1 - b) + pixels[bottom, right] * b
            truth[row, column] = above * (1 - a) + below * a
    got = resize_tf1(tensor(pixels), size)[0].permute(1, 2, 0).numpy()
    np.testing.assert_allclose(got, truth, atol=1e-9)


def test_modes_differ_by_grey_levels():
    pixels = tensor(image(90, 160))
    assert float((resize_clean(pixels, 29) - resize_tf1(pixels, 29)).abs().mean()) > 2.0


@pytest.mark.parametrize(("height", "width"), [(54, 96), (96, 54), (30, 30), (7, 224)])
def test_video_crops(height, width):
    """A ramp shows which part of the frame was taken."""
    ramp = torch.linspace(0, 1, width).expand(1, 3, height, width)
    direct, cut = resize_video(ramp, "direct224"), resize_video(ramp, "centre-crop")
    assert direct.shape == cut.shape == (1, 3, 224, 224)
    assert float(direct.min()) < 0.02
    assert float(direct.max()) > 0.98
    if width > height:
        seen = float(cut.max() - cut.min())
        assert seen == pytest.approx(height / width, abs=0.05)
        assert float(cut.mean()) == pytest.approx(0.5, abs=0.02)
