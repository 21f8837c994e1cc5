import dataclasses

import numpy as np
import pytest
import torch

from mirror.errors import UsageError
from mirror.metrics.features.cache import FeatureCache
from mirror.metrics.features.fvd import VideoFeatures, fvd, load_i3d
from mirror.weights import resolve
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.resolve import WeightResolver, file_sha256
from mirror.weights.table import KNOWN
from tests.metrics.networks.i3d_states import random_state


class Means(torch.nn.Module):
    """A stand-in with the published script's signature: means of a grid, 400 of them."""

    def forward(self, clips: torch.Tensor, rescale: bool = True, resize: bool = True, return_features: bool = False):
        if rescale or resize or not return_features:
            raise ValueError("asked for what is done outside")
        return torch.nn.functional.adaptive_avg_pool3d(clips.mean(dim=1, keepdim=True), (4, 10, 10)).flatten(1)


def means(crop="direct224"):
    return VideoFeatures(lambda clips: Means()(clips, False, False, True), crop, name="smoke", batch=2)


def clips(count, frames=9, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (count, frames, 18, 32, 3), dtype=np.uint8)


def test_figure():
    network = means()
    got = fvd(clips(4), clips(3, seed=1), network)
    assert got.value > 0.0
    assert (got.name, got.frames, got.crop, got.frechet.n, got.frechet.ddof) == ("smoke", 9, "direct224", (4, 3), 1)
    assert "fewer than the 400" in got.warning
    assert network.computed == 7


def test_names_of_variants_matter():
    a, b = clips(4), clips(4, seed=1)
    one = fvd(a, b, means())
    assert fvd(a, b, means(), ddof=0).value < one.value
    assert fvd(a, b, means("centre-crop")).value != one.value
    assert fvd(a, a, means()).value == 0.0


def test_range():
    seen = []

    def network(batch):
        seen.append((float(batch.min()), float(batch.max()), tuple(batch.shape)))
        return torch.zeros(len(batch), 400)

    extractor = VideoFeatures(network, name="smoke")
    fvd(np.stack([np.zeros((9, 8, 8, 3), np.uint8), np.full((9, 8, 8, 3), 255, np.uint8)]), clips(2), extractor)
    assert [round(value, 5) for each in seen[:2] for value in each[:2]] == [-1.0, -1.0, 1.0, 1.0]
    assert seen[0][2] == (1, 3, 9, 224, 224)


@pytest.mark.parametrize("frames", [1, 6, 8])
def test_short_clips(frames):
    with pytest.raises(UsageError, match="9 frames or more"):
        fvd(clips(2, frames), clips(2, frames), means())


def test_errors(tmp_path):
    for call in (
        lambda: fvd([*clips(1), *clips(1, 10)], clips(2), means()),
        lambda: fvd(clips(2), clips(2, 10), means()),
        lambda: fvd(clips(1), clips(2), means()),
        lambda: fvd([], clips(2), means()),
        lambda: fvd(clips(2)[..., 0], clips(2), means()),
        lambda: means("corner"),
        lambda: VideoFeatures(torch.nn.Identity(), name="fvd"),
    ):
        with pytest.raises(UsageError):
            call()
    network, cache = means(), FeatureCache(tmp_path)
    fvd(clips(2), clips(2, seed=1), network, cache=cache)
    fvd(clips(2, 10), clips(2, 10, seed=1), network, cache=cache)
    with pytest.raises(UsageError, match="after clips of"):
        fvd(clips(2), clips(2, 10, seed=1), network, cache=cache)
    assert network.computed == 8


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_published_script(tmp_path, monkeypatch):
    """Given by hash, run as a script, asked for features only: sizes and range are ours."""
    path = tmp_path / "i3d_torchscript.pt"
    torch.jit.script(Means()).save(str(path))
    known = dataclasses.replace(KNOWN["i3d-torchscript"], sha256=file_sha256(path), size=None)
    monkeypatch.setattr(resolve, "KNOWN", KNOWN | {"i3d-torchscript": known})
    network = load_i3d(resolver=WeightResolver({"i3d-torchscript": path}))
    a, b = clips(3), clips(3, seed=1)
    assert network.name == "fvd"
    assert fvd(a, b, network).value == pytest.approx(fvd(a, b, means()).value, rel=1e-6)
    text = tmp_path / "text.pt"
    text.write_text("no")
    monkeypatch.setattr(
        resolve, "KNOWN", {"i3d-torchscript": dataclasses.replace(known, sha256=file_sha256(text), size=None)}
    )
    with pytest.raises(WeightsUnavailableError, match="not a TorchScript"):
        load_i3d(resolver=WeightResolver({"i3d-torchscript": text}))


def test_published_state_dict(tmp_path):
    """No hash of it is published, and its figures say so."""
    path = tmp_path / "i3d_pretrained_400.pt"
    torch.save(random_state(), path)
    network = load_i3d(resolver=WeightResolver({"i3d-state-dict": path}), file="i3d-state-dict")
    assert network.name == "fvd-unpinned"
    assert network.weights == {"i3d-state-dict": file_sha256(path)}
    torch.save({"logits.conv3d.bias": torch.zeros(400)}, path)
    with pytest.raises(WeightsUnavailableError, match="is missing"):
        load_i3d(resolver=WeightResolver({"i3d-state-dict": path}), file="i3d-state-dict")
