"""Settings of the tiny network and of its training."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

from mirror.errors import UsageError

CLASSES: Final = ("car", "truck", "motorcycle", "pedestrian")
"""Classes of the tiny network. It takes vans as cars, buses as trucks, and bicycles and cyclists as motorcycles."""

CLASS_OF: Final[Mapping[str, str]] = {
    "car": "car",
    "van": "car",
    "truck": "truck",
    "bus": "truck",
    "motorcycle": "motorcycle",
    "bicycle": "motorcycle",
    "cyclist": "motorcycle",
    "pedestrian": "pedestrian",
}
"""The class of each category of boxes; boxes of other categories are left out."""


@dataclass(frozen=True)
class NetworkSettings:
    """Sizes of the layers of petr-tiny.

    Attributes:
        width_px: width of the network's images, a multiple of 16.
        height_px: their height, a multiple of 16.
        channels: channels of the backbone at strides 2, 4, 8 and 16.
        dim: channels of tokens and queries.
        layers: decoder layers.
        heads: heads of the attention.
        hidden: hidden channels of the feed-forward layers.
        depths: points of each ray in the position encoding.
        depth_start_m: distance of the first one.
        queries: learned queries.
        proposals: queries that start from the dense head's best boxes.
        box_range_m: range of box centres: least x, y, z, then greatest.
    """

    width_px: int = 192
    height_px: int = 112
    channels: tuple[int, int, int, int] = (12, 24, 48, 64)
    dim: int = 64
    layers: int = 2
    heads: int = 4
    hidden: int = 192
    depths: int = 32
    depth_start_m: float = 1.0
    queries: int = 60
    proposals: int = 40
    box_range_m: tuple[float, ...] = (-48.0, -48.0, -6.0, 48.0, 48.0, 8.0)


@dataclass(frozen=True)
class TrainingSettings:
    """Settings of the training of petr-tiny.

    Attributes:
        batch: frames of a step.
        learning_rate: highest learning rate of AdamW; it rises in `warmup` steps, then falls to 0 along a cosine.
        warmup: steps of rising learning rate.
        weight_decay: weight decay of AdamW.
        ema: highest decay of the averaged parameters, which are those of the model.
        turn_deg: frames are turned about the vertical by a random angle up to this one.
        dense_weight: weight of the dense head's losses.
        range_m: boxes farther from the vehicle are not used.
    """

    batch: int = 2
    learning_rate: float = 1e-3
    warmup: int = 50
    weight_decay: float = 0.01
    ema: float = 0.995
    turn_deg: float = 45.0
    dense_weight: float = 1.0
    range_m: float = 45.0


def training_settings(given: Mapping[str, str]) -> TrainingSettings:
    """Parse the training settings from texts by name.

    Raises:
        UsageError: a name is unknown, or a value is not a number in its range.
    """
    known = {field.name: field.type for field in dataclasses.fields(TrainingSettings)}
    values: dict[str, Any] = {}
    for name, text in given.items():
        if name not in known:
            raise UsageError(f"no setting {name!r}", place="--set", expected=", ".join(known))
        try:
            value = int(text) if known[name] == "int" else float(text)
        except ValueError:
            value = -1
        if not 0 <= value < 1e6 or (name == "batch" and value < 1) or (name == "ema" and value >= 1):
            raise UsageError(text, place=f"--set {name}", expected="a number in the range of this setting")
        values[name] = value
    return TrainingSettings(**values)


def document(settings: NetworkSettings | TrainingSettings) -> dict[str, Any]:
    """Return the settings as JSON values."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(settings).items()}
