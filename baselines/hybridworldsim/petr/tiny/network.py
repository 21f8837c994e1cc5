"""The tiny network: convolutions, a dense head that proposes boxes with depth, and PETR's decoder, which refines them.

Cameras are rays: each token has the direction of its ray and the place of its camera in the ego frame. Lenses and rigs
are free, and images keep their own lens.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from hybridworldsim.petr.decoder import DecoderLayer
from hybridworldsim.petr.encoding import encode_points, inverse_sigmoid, lid_depths, query_sine
from hybridworldsim.petr.head import HeadOutput
from hybridworldsim.petr.tiny.dense import DenseHead, DenseOutput, decode_cells
from hybridworldsim.petr.tiny.settings import CLASSES, NetworkSettings

STRIDE = 8
_RARE = -math.log((1 - 0.01) / 0.01)
_CODE = 10


@dataclass(frozen=True, eq=False)
class TinyRigInput:
    """Images and rays of B frames of N cameras.

    Attributes:
        images: (B, N, 3, H, W) from -1 to 1.
        directions: (B, N, H / 8, W / 8, 3) unit vectors of the rays of tokens, in the ego frame.
        origins: (B, N, 3) places of the cameras.
    """

    images: Tensor
    directions: Tensor
    origins: Tensor


class _Residual(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            *(nn.Conv2d(channels, channels, 3, padding=1, bias=False), nn.BatchNorm2d(channels), nn.ReLU(True)),
            *(nn.Conv2d(channels, channels, 3, padding=1, bias=False), nn.BatchNorm2d(channels)),
        )

    def forward(self, x: Tensor) -> Tensor:
        return (x + self.layers(x)).relu()


def _down(channels: int, out: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(channels, out, 3, 2, 1, bias=False), nn.BatchNorm2d(out), nn.ReLU(True))


class Backbone(nn.Module):
    """A network that maps images (B, 3, H, W) to features (B, dim, H / 8, W / 8)."""

    def __init__(self, channels: tuple[int, int, int, int], dim: int) -> None:
        super().__init__()
        first, second, third, fourth = channels
        self.stem = nn.Sequential(_down(3, first), _down(first, second), _Residual(second))
        self.third = nn.Sequential(_down(second, third), _Residual(third))
        self.fourth = nn.Sequential(_down(third, fourth), _Residual(fourth), _Residual(fourth))
        self.lateral, self.top = nn.Conv2d(third, dim, 1), nn.Conv2d(fourth, dim, 1)
        self.out = nn.Sequential(nn.Conv2d(dim, dim, 3, padding=1, bias=False), nn.BatchNorm2d(dim), nn.ReLU(True))

    def forward(self, images: Tensor) -> Tensor:
        """Map (B, 3, H, W) to (B, dim, H / 8, W / 8)."""
        third = self.third(self.stem(images))
        top = nn.functional.interpolate(self.top(self.fourth(third)), size=third.shape[-2:], mode="nearest")
        out: Tensor = self.out(self.lateral(third) + top)
        return out


class TinyPetr(nn.Module):
    """The network of petr-tiny.

    Args:
        settings: sizes.
    """

    box_range: Tensor
    depths: Tensor

    def __init__(self, settings: NetworkSettings) -> None:
        super().__init__()
        self.settings = settings
        dim = settings.dim
        self.register_buffer("box_range", torch.tensor(settings.box_range_m), persistent=False)
        reach = settings.box_range_m[3]
        self.register_buffer("depths", lid_depths(settings.depths, settings.depth_start_m, reach), persistent=False)
        self.backbone = Backbone(settings.channels, dim)
        self.dense_head = DenseHead(dim, len(CLASSES))
        self.position_encoder = nn.Sequential(
            nn.Conv2d(3 * settings.depths, dim, 1), nn.ReLU(True), nn.Conv2d(dim, dim, 1)
        )
        self.reference_points = nn.Parameter(torch.rand(settings.queries, 3))
        self.query_embedding = nn.Sequential(nn.Linear(3 * (dim // 2), dim), nn.ReLU(True), nn.Linear(dim, dim))
        self.proposal_content = nn.Linear(dim, dim)
        self.layers = nn.ModuleList(
            DecoderLayer(dim, settings.heads, settings.hidden, 0.0) for _ in range(settings.layers)
        )
        self.post_norm = nn.LayerNorm(dim)
        last, last_class = nn.Linear(dim, _CODE), nn.Linear(dim, len(CLASSES))
        self.classifier = nn.Sequential(nn.Linear(dim, dim), nn.LayerNorm(dim), nn.ReLU(True), last_class)
        self.regressor = nn.Sequential(nn.Linear(dim, dim), nn.ReLU(True), nn.Linear(dim, dim), nn.ReLU(True), last)
        # A query starts as its proposal.
        for layer in (last, last_class):
            nn.init.normal_(layer.weight, std=1e-3)
            nn.init.zeros_(layer.bias)

    def forward(self, rig: TinyRigInput) -> tuple[HeadOutput, DenseOutput]:
        """Return the boxes of all decoder layers, and the outputs of the dense head."""
        batch, cameras = rig.images.shape[:2]
        features = self.backbone(rig.images.flatten(0, 1))
        directions, origins = rig.directions.flatten(0, 1), rig.origins.flatten(0, 1)
        dense, features = self.dense_head(features, directions, origins)
        dense = dense.of_frames(batch)
        points = origins[:, None, None, None] + directions[..., None, :] * self.depths[:, None]
        position = self.position_encoder(encode_points(points, self.box_range))
        memory, memory_position = _tokens(features, cameras), _tokens(position, cameras)

        reference, logits, code, content = self._proposals(dense, memory)
        learned = self.reference_points.clamp(0.0, 1.0).expand(batch, -1, -1)
        none = learned.new_zeros(batch, learned.shape[1], 1)
        reference = torch.cat((learned, reference), 1)
        logits = torch.cat(((none + _RARE).expand(-1, -1, logits.shape[-1]), logits), 1)
        code = torch.cat((none.expand(-1, -1, _CODE), code), 1)
        x = torch.cat((none.expand(-1, -1, content.shape[-1]), content), 1)
        place = self.query_embedding(query_sine(reference, self.settings.dim // 2))
        all_logits, all_codes = [], []
        for layer in self.layers:
            x = layer(x, place, memory, memory_position)
            queries = self.post_norm(x)
            all_logits.append(logits + self.classifier(queries))
            all_codes.append(self._read(code, reference, self.regressor(queries)))
        return HeadOutput(torch.stack(all_logits), torch.stack(all_codes)), dense

    def _proposals(self, dense: DenseOutput, memory: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Reference points in 0..1, logits, codes and contents (B, P, ...) of the dense head's best cells."""
        peaks = dense.peaks().flatten(1)
        cells = peaks.topk(min(self.settings.proposals, peaks.shape[1]), 1).indices
        boxes = decode_cells(dense.gather(cells))
        low, high = self.box_range[:3], self.box_range[3:]
        reference = ((boxes.code[..., [0, 1, 4]] - low) / (high - low)).clamp(0.0, 1.0)
        content = self.proposal_content(memory.gather(1, cells[..., None].expand(-1, -1, memory.shape[-1])))
        # The dense head is trained by its own losses alone.
        return reference.detach(), boxes.logits.detach(), boxes.code.detach(), content

    def _read(self, code: Tensor, reference: Tensor, change: Tensor) -> Tensor:
        low, high = self.box_range[:3], self.box_range[3:]
        centre = (inverse_sigmoid(reference) + change[..., [0, 1, 4]]).sigmoid() * (high - low) + low
        other = code + change
        return torch.cat((centre[..., :2], other[..., 2:4], centre[..., 2:], other[..., 5:]), -1)


def _tokens(maps: Tensor, cameras: int) -> Tensor:
    """(B N, C, H, W) to (B, N H W, C)."""
    return maps.flatten(2).unflatten(0, (-1, cameras)).permute(0, 1, 3, 2).flatten(1, 2)
