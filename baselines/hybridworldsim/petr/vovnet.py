"""VoVNet-99 with effective squeeze and excitation (Y. Lee and J. Park, CenterMask, CVPR 2020): the larger backbone.

The names of the parameters are those of the published checkpoints.
"""

from __future__ import annotations

from collections import OrderedDict

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

_STEM = (64, 64, 128)
_CHANNELS = (128, 160, 192, 224)
_OUTPUTS = (256, 512, 768, 1024)
_BLOCKS = (1, 3, 9, 3)
_LAYERS = 5


def _convolution(inputs: int, outputs: int, name: str, kernel: int, stride: int = 1) -> list[tuple[str, nn.Module]]:
    return [
        (f"{name}/conv", nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False)),
        (f"{name}/norm", nn.BatchNorm2d(outputs)),
        (f"{name}/relu", nn.ReLU(inplace=True)),
    ]


class ChannelGate(nn.Module):
    """A gate that scales each channel by a factor computed from the means of all channels."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.fc = nn.Conv2d(channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, C, H, W) to the same shape."""
        return x * (F.relu6(self.fc(x.mean((2, 3), keepdim=True)) + 3.0) / 6.0)


class Aggregation(nn.Module):
    """One-shot aggregation: five convolutions, whose outputs are concatenated once."""

    def __init__(self, inputs: int, channels: int, outputs: int, name: str, *, identity: bool) -> None:
        super().__init__()
        self.identity = identity
        widths = [inputs, *[channels] * (_LAYERS - 1)]
        self.layers = nn.ModuleList(
            nn.Sequential(OrderedDict(_convolution(width, channels, f"{name}_{layer}", 3)))
            for layer, width in enumerate(widths)
        )
        self.concat = nn.Sequential(
            OrderedDict(_convolution(inputs + _LAYERS * channels, outputs, f"{name}_concat", 1))
        )
        self.ese = ChannelGate(outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, inputs, H, W) to (N, outputs, H, W)."""
        parts = [x]
        for layer in self.layers:
            parts.append(layer(parts[-1]))
        out: Tensor = self.ese(self.concat(torch.cat(parts, 1)))
        return out + x if self.identity else out


class VoVNet99(nn.Module):
    """The backbone; its outputs have strides 16 and 32."""

    channels = (_OUTPUTS[2], _OUTPUTS[3])
    strides = (16, 32)

    def __init__(self) -> None:
        super().__init__()
        stem = _convolution(3, _STEM[0], "stem_1", 3, 2)
        stem += _convolution(_STEM[0], _STEM[1], "stem_2", 3)
        stem += _convolution(_STEM[1], _STEM[2], "stem_3", 3, 2)
        self.stem = nn.Sequential(OrderedDict(stem))
        inputs = _STEM[2]
        for stage, (channels, outputs, blocks) in enumerate(zip(_CHANNELS, _OUTPUTS, _BLOCKS), start=2):
            parts: list[tuple[str, nn.Module]] = []
            if stage > 2:
                parts.append(("Pooling", nn.MaxPool2d(3, 2, ceil_mode=True)))
            for block in range(1, blocks + 1):
                name = f"OSA{stage}_{block}"
                parts.append((name, Aggregation(inputs, channels, outputs, name, identity=block > 1)))
                inputs = outputs
            self.add_module(f"stage{stage}", nn.Sequential(OrderedDict(parts)))

    def forward(self, images: Tensor) -> list[Tensor]:
        """Map (N, 3, H, W) to features of strides 16 and 32."""
        x = self.stem(images)
        outputs = []
        for stage in range(2, 6):
            x = self.get_submodule(f"stage{stage}")(x)
            if stage >= 4:
                outputs.append(x)
        return outputs
