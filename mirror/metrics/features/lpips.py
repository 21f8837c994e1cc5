"""LPIPS v0.1 (Zhang et al., "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric", 2018)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

from mirror.arrays import AnyArray, Bool
from mirror.errors import UsageError
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


def load_lpips(net: LpipsNet = "alex", resolver: WeightResolver | None = None) -> PerceptualDistance:
    """The network behind LPIPS, from torchvision's trunk and the published heads.

    Args:
        net: ``alex`` as DriveStudio, MTGS and most of the field report; ``vgg`` as 3DGS does; ``squeeze``.
        resolver: where to look for weights.

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
    return PerceptualDistance(f"lpips-{net}", filled(trunk, trunk_state, unused=("classifier.",)), heads, files)


def lpips(
    render: AnyArray,
    truth: AnyArray,
    network: PerceptualDistance,
    *,
    mask: Bool | None = None,
    masked: Masked = "map",
) -> Score:
    """LPIPS of a render.

    For many renders of one truth call the network itself: ``network(renders, truth)``.

    Args:
        render: (h, w, 3), uint8 or floats from 0 to 1.
        truth: (h, w, 3).
        network: of `load_lpips`.
        mask: (h, w), true where pixels count.
        masked: ``map`` or ``zero-fill``, see `PerceptualDistance`.

    Raises:
        UsageError: another network than LPIPS's, or pictures that do not fit.
    """
    if not network.name.startswith("lpips-"):
        raise UsageError(f"{network.name} is not LPIPS", remedy="call the network itself, and its figures by its name")
    return network([render], truth, mask, masked)[0]


def lpips_trunk(net: LpipsNet) -> Trunk:
    """An unfilled trunk.

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
    """Weights of the taps' channels from ``lin0.model.1.weight`` and so on.

    Raises:
        WeightsUnavailableError: one is missing or left over.
    """
    names = [f"lin{tap}.model.1.weight" for tap in range(taps)]
    if sorted(state) != sorted(names):
        raise WeightsUnavailableError(f"heads called {', '.join(sorted(state))}", expected=", ".join(names))
    return [state[name] for name in names]
