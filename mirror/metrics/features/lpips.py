"""LPIPS v0.1 (Zhang et al., "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric", 2018)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, overload

from mirror.devices import CPU
from mirror.errors import UsageError
from mirror.metrics.inputs import BatchLayout, ImageLayout, Layout, Pixels, as_images, as_masks, of_layout
from mirror.metrics.score import Score
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.load import load_state_dict
from mirror.weights.resolve import WeightResolver

if TYPE_CHECKING:
    from torch import Tensor

    from mirror.metrics.features.perceptual import Masked, PerceptualDistance
    from mirror.metrics.networks.trunk import Trunk

LpipsNet = Literal["alex", "vgg", "squeeze"]

TRUNK_WEIGHTS: Mapping[LpipsNet, str] = {"alex": "alexnet", "vgg": "vgg16", "squeeze": "squeezenet1_1"}


def load_lpips(net: LpipsNet = "alex", resolver: WeightResolver | None = None, device: str = CPU) -> PerceptualDistance:
    """Return the network behind LPIPS, from torchvision's trunk and the published heads.

    Args:
        net: ``alex`` as DriveStudio, MTGS and most of the field report; ``vgg`` as 3DGS does; ``squeeze``.
        resolver: where to look for weights.
        device: where it runs, as torch names it.

    Raises:
        WeightsUnavailableError: a file is not there or is another one.
        UsageError: no such net.
    """
    from mirror.metrics.features.perceptual import PerceptualDistance, filled

    trunk = lpips_trunk(net)
    resolver = resolver or WeightResolver()
    files = (resolver.resolve(TRUNK_WEIGHTS[net]), resolver.resolve(f"lpips-heads-{net}"))
    trunk_state, head_state = (load_state_dict(file.path) for file in files)
    heads = lpips_heads(head_state, len(trunk.channels))
    return PerceptualDistance(f"lpips-{net}", filled(trunk, trunk_state, unused=("classifier.",)), heads, files, device)


@overload
def lpips(
    render: Pixels,
    truth: Pixels,
    network: PerceptualDistance,
    *,
    mask: Pixels | None = None,
    masked: Masked = "map",
    layout: ImageLayout | None = None,
) -> Score: ...
@overload
def lpips(
    render: Pixels,
    truth: Pixels,
    network: PerceptualDistance,
    *,
    mask: Pixels | None = None,
    masked: Masked = "map",
    layout: BatchLayout,
) -> list[Score]: ...
def lpips(
    render: Pixels,
    truth: Pixels,
    network: PerceptualDistance,
    *,
    mask: Pixels | None = None,
    masked: Masked = "map",
    layout: Layout | None = None,
) -> Score | list[Score]:
    """Return the LPIPS of a render.

    For many renders of one truth call the network itself: ``network(renders, truth)``.

    Args:
        render: (h, w, 3), or as ``layout`` says; an array or a torch tensor on the CPU, uint8 or floats from 0 to 1.
        truth: of the same shape.
        network: of `load_lpips`.
        mask: (h, w) bool, true where pixels count; of a batch also (n, h, w).
        masked: ``map`` or ``zero-fill``, see `PerceptualDistance`.
        layout: as of `mirror.metrics.images.psnr.psnr`.

    Returns:
        The distance; of a batch a list, one an image.

    Raises:
        UsageError: another network than LPIPS's, or images that do not fit.
    """
    if not network.name.startswith("lpips-"):
        raise UsageError(f"{network.name} is not LPIPS", remedy="call the network itself, and its figures by its name")
    return pair_distances(network, render, truth, mask, masked, layout)


def pair_distances(
    network: PerceptualDistance,
    render: Pixels,
    truth: Pixels,
    mask: Pixels | None,
    masked: Masked,
    layout: Layout | None,
) -> Any:
    """Compute the distance of a render from its truth, or the list of distances of a batch.

    Raises:
        UsageError: images or masks do not fit.
    """
    renders, truths = as_images(render, "render", layout), as_images(truth, "truth", layout)
    if len(renders) != len(truths):
        raise UsageError(f"{len(renders)} renders and {len(truths)} truths", expected="as many of both")
    masks = as_masks(mask, layout, len(renders))
    return of_layout([network([one], other, own, masked)[0] for one, other, own in zip(renders, truths, masks)], layout)


def lpips_trunk(net: LpipsNet) -> Trunk:
    """Make the trunk of a net, without weights.

    Raises:
        UsageError: no such net.
    """
    from mirror.metrics.networks.alexnet import AlexNetTrunk
    from mirror.metrics.networks.squeezenet import SqueezeNetTrunk
    from mirror.metrics.networks.vgg import Vgg16Trunk

    kinds: Mapping[str, type[Trunk]] = {"alex": AlexNetTrunk, "vgg": Vgg16Trunk, "squeeze": SqueezeNetTrunk}
    if net not in kinds:
        raise UsageError(f"no LPIPS net is called {net!r}", expected=", ".join(kinds))
    return kinds[net]()


def lpips_heads(state: Mapping[str, Tensor], taps: int) -> list[Tensor]:
    """Return the weights of the taps' channels from tensors such as ``lin0.model.1.weight``.

    Raises:
        WeightsUnavailableError: one is missing or left over.
    """
    names = [f"lin{tap}.model.1.weight" for tap in range(taps)]
    if sorted(state) != sorted(names):
        raise WeightsUnavailableError(f"heads called {', '.join(sorted(state))}", expected=", ".join(names))
    return [state[name] for name in names]
