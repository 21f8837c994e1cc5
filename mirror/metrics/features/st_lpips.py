"""ST-LPIPS (Ghildyal and Liu, "Shift-tolerant Perceptual Similarity Metric", 2022): a metric of its own, not LPIPS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal, overload

from mirror.devices import CPU
from mirror.errors import UsageError
from mirror.metrics.features.lpips import lpips_heads, pair_distances
from mirror.metrics.inputs import BatchLayout, ImageLayout, Layout, Pixels
from mirror.metrics.score import Score
from mirror.weights.load import load_state_dict
from mirror.weights.resolve import WeightResolver

if TYPE_CHECKING:
    from torch import Tensor

    from mirror.metrics.features.perceptual import Masked, PerceptualDistance
    from mirror.metrics.networks.trunk import Trunk

StLpipsNet = Literal["alex", "vgg"]


def load_st_lpips(
    net: StLpipsNet = "alex", resolver: WeightResolver | None = None, device: str = CPU
) -> PerceptualDistance:
    """Return the network behind ST-LPIPS, with the ``stlpips-pytorch`` package's weights and none of its code.

    Raises:
        WeightsUnavailableError: the file is not there or is another one.
        UsageError: no such net.
    """
    from mirror.metrics.features.perceptual import PerceptualDistance, filled

    trunk = st_lpips_trunk(net)
    file = (resolver or WeightResolver()).resolve(f"st-lpips-{net}")
    layers, heads = split_state(load_state_dict(file.path))
    return PerceptualDistance(
        f"st_lpips-{net}", filled(trunk, layers), lpips_heads(heads, len(trunk.channels)), [file], device
    )


@overload
def st_lpips(
    render: Pixels,
    truth: Pixels,
    network: PerceptualDistance,
    *,
    mask: Pixels | None = None,
    masked: Masked = "map",
    layout: ImageLayout | None = None,
) -> Score: ...
@overload
def st_lpips(
    render: Pixels,
    truth: Pixels,
    network: PerceptualDistance,
    *,
    mask: Pixels | None = None,
    masked: Masked = "map",
    layout: BatchLayout,
) -> list[Score]: ...
def st_lpips(
    render: Pixels,
    truth: Pixels,
    network: PerceptualDistance,
    *,
    mask: Pixels | None = None,
    masked: Masked = "map",
    layout: Layout | None = None,
) -> Score | list[Score]:
    """Return the ST-LPIPS of a render; see `mirror.metrics.features.lpips.lpips` for the arguments.

    Raises:
        UsageError: another network than ST-LPIPS's, or images that do not fit.
    """
    if not network.name.startswith("st_lpips-"):
        raise UsageError(f"{network.name} is not ST-LPIPS", remedy="load it with load_st_lpips")
    return pair_distances(network, render, truth, mask, masked, layout)


def st_lpips_trunk(net: StLpipsNet) -> Trunk:
    """Make the trunk of a net, without weights.

    Raises:
        UsageError: no such net.
    """
    from mirror.metrics.networks.shift_tolerant import ShiftTolerantAlexNetTrunk, ShiftTolerantVgg16Trunk

    kinds: Mapping[str, type[Trunk]] = {"alex": ShiftTolerantAlexNetTrunk, "vgg": ShiftTolerantVgg16Trunk}
    if net not in kinds:
        raise UsageError(f"no ST-LPIPS net is called {net!r}", expected=", ".join(kinds))
    return kinds[net]()


def split_state(state: Mapping[str, Tensor]) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Split the published file into trunk and heads: ``net.slice2.5.weight`` is layer 5 of the features."""
    layers, heads = {}, {}
    for name, tensor in state.items():
        if name.startswith("net.slice"):
            layers[f"features.{name.split('.', 2)[2]}"] = tensor
        elif not name.startswith("scaling_layer."):
            heads[name] = tensor
    return layers, heads
