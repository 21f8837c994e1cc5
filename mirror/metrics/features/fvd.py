"""Fréchet video distance (Unterthiner et al., 2018) of two sets of clips."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from mirror.arrays import AnyArray, Float32, UInt8
from mirror.devices import CPU
from mirror.errors import UsageError
from mirror.metrics.features.cache import FeatureCache
from mirror.metrics.features.extractor import checked_name, extract, identity_of_device
from mirror.metrics.features.frechet import FrechetDistance, frechet_distance
from mirror.metrics.inputs import Pixels, as_array, channels_last
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.load import load_state_dict
from mirror.weights.resolve import ResolvedWeights, WeightResolver

if TYPE_CHECKING:
    from torch import Tensor

    from mirror.metrics.networks.resize import VideoCrop

I3dFile = Literal["i3d-torchscript", "i3d-state-dict"]

_ENOUGH = 400


@dataclass(frozen=True)
class Fvd:
    """A Fréchet video distance with everything that it depends on.

    Attributes:
        name: ``fvd``, or the name of another network.
        frechet: the distance, with error bound, rank, n and ddof.
        crop: ``direct224 | centre-crop``.
        frames: of every clip.
        weights: hash of the network's file, by name.
        warning: why the figure is not to be compared with others; None if it is.
    """

    name: str
    frechet: FrechetDistance
    crop: VideoCrop
    frames: int
    weights: Mapping[str, str]
    warning: str | None

    @property
    def value(self) -> float:
        """The Fréchet distance."""
        return self.frechet.value


class VideoFeatures:
    """The network behind FVD.

    Args:
        network: from clips (n, 3, t, 224, 224), -1 to 1, to logits (n, 400).
        crop: ``direct224`` as TensorFlow's and cd-fvd's, ``centre-crop`` as VideoGPT's and common_metrics'.
        name: what figures are called; ``fvd`` only with published weights of a known hash.
        weights: the file that the network came from.
        batch: clips at once.
        device: where the network is, as torch names it; part of the identity, because its sums differ.

    Attributes:
        frames: of every clip so far; all must have as many. None before the first.

    Raises:
        UsageError: a published name with other weights, or no such crop.
    """

    def __init__(
        self,
        network: Callable[[Tensor], Tensor],
        crop: VideoCrop = "direct224",
        *,
        name: str,
        weights: Sequence[ResolvedWeights] = (),
        batch: int = 1,
        device: str = CPU,
    ) -> None:
        if crop not in ("direct224", "centre-crop"):
            raise UsageError(f"crop is {crop!r}", expected="'direct224' or 'centre-crop'")
        pinned = bool(weights) and all(file.pinned for file in weights)
        # An unpinned file may be named after what it claims to be, but never without saying so.
        self.name = checked_name(name, () if name == UNPINNED else ("fvd",), pinned=pinned)
        self.crop: VideoCrop = crop
        self.weights = {file.name: file.sha256 for file in weights}
        self.identity = f"{name} {crop} {sorted(self.weights.items())}{identity_of_device(device)}"
        self.batch, self.computed = batch, 0
        self.frames: int | None = None
        self._network, self._device = network, device

    def prepare(self, pixels: UInt8) -> Tensor:
        """Convert one clip (t, h, w, 3) to the network's input (3, t, 224, 224), -1 to 1.

        Raises:
            UsageError: another shape, too short, or not as long as those before.
        """
        import torch

        from mirror.metrics.networks.resize import resize_video

        self.check(pixels)
        frames = torch.from_numpy(np.ascontiguousarray(pixels)).permute(0, 3, 1, 2).float()
        return (resize_video(frames, self.crop) / 127.5 - 1.0).permute(1, 0, 2, 3)

    def check(self, clip: AnyArray) -> None:
        """Check that the network can take a clip.

        Raises:
            UsageError: another shape, too short, or not as long as those before.
        """
        from mirror.metrics.networks.i3d import MINIMUM_FRAMES

        if clip.ndim != 4 or clip.shape[3] != 3 or 0 in clip.shape:
            raise UsageError(f"a clip of shape {clip.shape}", expected="(frames, h, w, 3)")
        if clip.shape[0] < MINIMUM_FRAMES:
            raise UsageError(
                f"a clip of {clip.shape[0]} frames: I3D halves time three times and then pools two steps",
                expected=f"{MINIMUM_FRAMES} frames or more; 16 are usual",
                remedy="cut longer clips; repeating frames would be scored as stillness",
            )
        if self.frames not in (None, clip.shape[0]):
            raise UsageError(f"a clip of {clip.shape[0]} frames after clips of {self.frames}")
        self.frames = clip.shape[0]

    def run(self, prepared: Tensor) -> Float32:
        """Return the logits (n, 400)."""
        import torch

        with torch.inference_mode():
            features: Float32 = self._network(prepared.to(self._device)).cpu().numpy()
        return features


UNPINNED = "fvd-unpinned"


def load_i3d(
    crop: VideoCrop = "direct224",
    resolver: WeightResolver | None = None,
    file: I3dFile = "i3d-torchscript",
    device: str = CPU,
) -> VideoFeatures:
    """Return the network behind FVD.

    Args:
        crop: ``direct224`` or ``centre-crop``.
        resolver: where to look for weights.
        file: ``i3d-torchscript``, whose hash is known; or ``i3d-state-dict``, for which none is published: its figures
            are called ``fvd-unpinned``.
        device: where it runs, as torch names it.

    Raises:
        WeightsUnavailableError: the file is not there or is another one.
    """
    found = (resolver or WeightResolver()).resolve(file)
    if file == "i3d-torchscript":
        return VideoFeatures(_scripted(found.path, device), crop, name="fvd", weights=[found], device=device)
    from mirror.metrics.networks.i3d import InflatedInception
    from mirror.metrics.networks.state import load_strictly

    network = InflatedInception()
    load_strictly(network, load_state_dict(found.path))
    return VideoFeatures(network.to(device), crop, name=UNPINNED, weights=[found], device=device)


def _scripted(path: Path, device: str) -> Callable[[Tensor], Tensor]:
    """The published script, after its hash was verified; resizing and scaling are done here, by name."""
    import warnings

    import torch

    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", category=DeprecationWarning, module="torch")
            network = torch.jit.load(str(path), map_location=device).eval()
    except RuntimeError as error:
        raise WeightsUnavailableError(
            f"not a TorchScript file: {error}".splitlines()[0],
            file=path,
            remedy="name the file that was downloaded, with --weights NAME=FILE",
        ) from error
    return lambda clips: network(clips, rescale=False, resize=False, return_features=True)


def fvd(
    renders: Iterable[Pixels],
    truth: Iterable[Pixels],
    network: VideoFeatures,
    *,
    ddof: int = 1,
    cache: FeatureCache | None = None,
    layout: Literal["nhwc", "nchw"] = "nhwc",
) -> Fvd:
    """Compute the Fréchet video distance between rendered clips and recorded ones.

    Args:
        renders: clips (frames, h, w, 3), or as ``layout`` says; arrays or torch tensors on the CPU, uint8 or floats
            from 0 to 1, all with as many frames; taken one by one.
        truth: likewise.
        network: of `load_i3d`.
        ddof: 1 as VideoGPT and common_metrics, 0 as StyleGAN-V and cd-fvd: at 100 clips 1 % less.
        cache: of features.
        layout: of a clip, whose frames are n: ``nhwc`` or ``nchw``.

    Raises:
        UsageError: fewer than 2 clips on a side, clips too short or of different lengths.
    """
    network.frames = None
    first = extract(network, _checked(renders, "render", network, layout), cache)
    second = extract(network, _checked(truth, "truth", network, layout), cache)
    distance = frechet_distance(first, second, ddof=ddof)
    warning = None
    if min(distance.n) < _ENOUGH:
        warning = (
            f"{min(distance.n)} clips are fewer than the {_ENOUGH} dimensions: the distance is too large by its bias"
        )
    return Fvd(network.name, distance, network.crop, network.frames or 0, network.weights, warning)


def _checked(
    clips: Iterable[Pixels], what: str, network: VideoFeatures, layout: Literal["nhwc", "nchw"]
) -> Iterable[AnyArray]:
    """The clips (frames, h, w, 3); their length is checked even where their features are cached."""
    for clip in clips:
        arranged = as_array(clip, what) if layout == "nhwc" else channels_last(clip, what, layout)
        network.check(arranged)
        yield arranged
