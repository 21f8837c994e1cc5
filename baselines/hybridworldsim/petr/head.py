"""The head of PETR: position encodings, queries, decoder and the branches that read boxes from queries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor, nn

from hybridworldsim.petr.decoder import PetrTransformer
from hybridworldsim.petr.encoding import encode_points, inverse_sigmoid, multiview_sine, query_sine

# The logarithm of the odds of 0.01: queries begin as background.
_RARE: Final = -4.6


@dataclass(frozen=True)
class HeadSettings:
    """Sizes and ranges; the defaults are the published ones.

    Attributes:
        classes: number of classes.
        dim: width of queries and features.
        queries: number of queries.
        layers: layers of the decoder.
        heads: heads of each attention.
        hidden: width of the feed-forward layers.
        depths: depths of a ray.
        depth_start_m: first depth.
        position_range_m: range of the points of rays.
        box_range_m: range of box centres.
        multiview: whether the camera's number is encoded, which ties the weights to one rig.
        dropout: share that is dropped in training.
        code_weights: weights of the ten values of a box in the loss; part of the checkpoint.
    """

    classes: int = 10
    dim: int = 256
    queries: int = 900
    layers: int = 6
    heads: int = 8
    hidden: int = 2048
    depths: int = 64
    depth_start_m: float = 1.0
    position_range_m: tuple[float, ...] = (-61.2, -61.2, -10.0, 61.2, 61.2, 10.0)
    box_range_m: tuple[float, ...] = (-51.2, -51.2, -5.0, 51.2, 51.2, 3.0)
    multiview: bool = True
    dropout: float = 0.1
    code_weights: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.2, 0.2)


@dataclass(frozen=True, eq=False)
class HeadOutput:
    """The outputs of all L decoder layers.

    Attributes:
        logits: (L, B, Q, classes).
        codes: (L, B, Q, 10) ``x y a b z log-height sin cos vx vy``; a and b are the logarithms of width and length, in
            the order of the checkpoint's generation (`hybridworldsim.petr.boxes`).
    """

    logits: Tensor
    codes: Tensor


class DetectionHead(nn.Module):
    """A head that maps features, each with the points of its ray, to boxes.

    Args:
        settings: sizes and ranges.
        channels: channels of the features.
    """

    position_range: Tensor
    box_range: Tensor

    def __init__(self, settings: HeadSettings, channels: int) -> None:
        super().__init__()
        self.settings = settings
        dim, half = settings.dim, settings.dim // 2
        self.register_buffer("position_range", torch.tensor(settings.position_range_m), persistent=False)
        self.register_buffer("box_range", torch.tensor(settings.box_range_m), persistent=False)
        self.code_weights = nn.Parameter(torch.tensor(settings.code_weights), requires_grad=False)
        self.input_proj = nn.Conv2d(channels, dim, 1)
        self.reference_points = nn.Embedding(settings.queries, 3)
        # One module at every layer: the checkpoint lists its weights once for each.
        last = nn.Linear(dim, settings.classes)
        classifier = nn.Sequential(
            *(nn.Linear(dim, dim), nn.LayerNorm(dim), nn.ReLU(inplace=True)),
            *(nn.Linear(dim, dim), nn.LayerNorm(dim), nn.ReLU(inplace=True)),
            last,
        )
        regressor = nn.Sequential(nn.Linear(dim, dim), nn.ReLU(), nn.Linear(dim, dim), nn.ReLU(), nn.Linear(dim, 10))
        self.cls_branches = nn.ModuleList([classifier] * settings.layers)
        self.reg_branches = nn.ModuleList([regressor] * settings.layers)
        if settings.multiview:
            self.adapt_pos3d = nn.Sequential(nn.Conv2d(3 * half, 4 * dim, 1), nn.ReLU(), nn.Conv2d(4 * dim, dim, 1))
        self.position_encoder = nn.Sequential(
            nn.Conv2d(3 * settings.depths, 4 * dim, 1), nn.ReLU(), nn.Conv2d(4 * dim, dim, 1)
        )
        self.query_embedding = nn.Sequential(nn.Linear(3 * half, dim), nn.ReLU(), nn.Linear(dim, dim))
        self.transformer = PetrTransformer(settings.layers, dim, settings.heads, settings.hidden, settings.dropout)
        nn.init.uniform_(self.reference_points.weight, 0.0, 1.0)
        nn.init.constant_(last.bias, _RARE)

    def encode_positions(self, points: Tensor) -> Tensor:
        """Encode the points of rays (B, N, H, W, D, 3) as (B, N, C, H, W)."""
        batch, cameras, height, width = points.shape[:4]
        encoded: Tensor = self.position_encoder(encode_points(points.flatten(0, 1), self.position_range))
        encoded = encoded.unflatten(0, (batch, cameras))
        if self.settings.multiview:
            sine = multiview_sine(cameras, height, width, self.settings.dim // 2, dtype=points.dtype)
            encoded = encoded + self.adapt_pos3d(sine.to(points.device))
        return encoded

    def forward(self, features: Tensor, points: Tensor) -> HeadOutput:
        """Find boxes in the features of images.

        Args:
            features: (B, N, channels, H, W) of N cameras.
            points: (B, N, H, W, D, 3) points of the rays through the features, in the frame of the boxes.
        """
        batch = features.shape[0]
        memory = self.input_proj(features.flatten(0, 1)).unflatten(0, features.shape[:2])
        reference = self.reference_points.weight
        position = self.query_embedding(query_sine(reference, self.settings.dim // 2)).expand(batch, -1, -1)
        outputs = self.transformer.decoder(
            torch.zeros_like(position), position, _tokens(memory), _tokens(self.encode_positions(points))
        )
        return self.read_boxes(outputs, reference.expand(batch, -1, -1))

    def read_boxes(self, outputs: list[Tensor], reference: Tensor) -> HeadOutput:
        """Read boxes from queries (B, Q, C) of each layer, with reference points (B, Q, 3) in 0..1."""
        odds = inverse_sigmoid(reference)
        low, high = self.box_range[:3], self.box_range[3:]
        logits, codes = [], []
        for layer, queries in enumerate(outputs):
            queries = torch.nan_to_num(queries)
            code = self.reg_branches[layer](queries)
            xy = (code[..., 0:2] + odds[..., 0:2]).sigmoid() * (high[:2] - low[:2]) + low[:2]
            z = (code[..., 4:5] + odds[..., 2:3]).sigmoid() * (high[2:] - low[2:]) + low[2:]
            codes.append(torch.cat((xy, code[..., 2:4], z, code[..., 5:]), -1))
            logits.append(self.cls_branches[layer](queries))
        return HeadOutput(torch.stack(logits), torch.stack(codes))


def _tokens(maps: Tensor) -> Tensor:
    """(B, N, C, H, W) to (B, N H W, C)."""
    return maps.permute(0, 1, 3, 4, 2).flatten(1, 3)
