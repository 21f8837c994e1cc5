"""PETR from its state dict, in float64 with plain loops: written from the published formulas, not from our modules."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

State = Mapping[str, Tensor]


def conv_bn(state: State, name: str, x: Tensor, stride: int = 1, padding: int = 0) -> Tensor:
    x = F.conv2d(x, state[f"{name}/conv.weight"], None, stride, padding)
    mean, var = state[f"{name}/norm.running_mean"], state[f"{name}/norm.running_var"]
    scale = state[f"{name}/norm.weight"] / torch.sqrt(var + 1e-5)
    return torch.relu((x - mean[:, None, None]) * scale[:, None, None] + state[f"{name}/norm.bias"][:, None, None])


def vovnet(state: State, x: Tensor) -> list[Tensor]:
    for stem, stride in ((1, 2), (2, 1), (3, 2)):
        x = conv_bn(state, f"img_backbone.stem.stem_{stem}", x, stride, 1)
    outputs = []
    for stage, blocks in ((2, 1), (3, 3), (4, 9), (5, 3)):
        if stage > 2:
            x = F.max_pool2d(x, 3, 2, ceil_mode=True)
        for block in range(1, blocks + 1):
            name, base = f"OSA{stage}_{block}", f"img_backbone.stage{stage}.OSA{stage}_{block}"
            parts = [x]
            for layer in range(5):
                parts.append(conv_bn(state, f"{base}.layers.{layer}.{name}_{layer}", parts[-1], 1, 1))
            y = conv_bn(state, f"{base}.concat.{name}_concat", torch.cat(parts, 1))
            gate = F.conv2d(y.mean((2, 3), keepdim=True), state[f"{base}.ese.fc.weight"], state[f"{base}.ese.fc.bias"])
            y = y * torch.clamp(gate + 3.0, 0.0, 6.0) / 6.0
            x = y + x if block > 1 else y
        outputs.append(x)
    return outputs[2:]


def neck(state: State, fine: Tensor, coarse: Tensor) -> Tensor:
    def conv(name: str, x: Tensor, padding: int = 0) -> Tensor:
        return F.conv2d(x, state[f"img_neck.{name}.conv.weight"], state[f"img_neck.{name}.conv.bias"], 1, padding)

    one, two = conv("lateral_convs.0", fine), conv("lateral_convs.1", coarse)
    rows = [min(r * two.shape[2] // one.shape[2], two.shape[2] - 1) for r in range(one.shape[2])]
    columns = [min(c * two.shape[3] // one.shape[3], two.shape[3] - 1) for c in range(one.shape[3])]
    return conv("fpn_convs.0", one + two[:, :, rows][:, :, :, columns], 1)


def depths(count: int = 64) -> list[float]:
    return [1.0 + (61.2 - 1.0) / (count * (1 + count)) * i * (i + 1) for i in range(count)]


def position_input(projections: np.ndarray, height: int, width: int, image: tuple[int, int]) -> Tensor:
    """(N, 192, H, W) by loops over pixels and depths."""
    low, high = np.array([-61.2, -61.2, -10.0]), np.array([61.2, 61.2, 10.0])
    out = np.zeros((len(projections), 192, height, width))
    for n, projection in enumerate(projections):
        inverse = np.linalg.inv(projection)
        for v in range(height):
            for u in range(width):
                for i, d in enumerate(depths()):
                    point = inverse @ (u * image[1] / width * d, v * image[0] / height * d, d, 1.0)
                    share = np.clip((point[:3] - low) / (high - low), 0.0, 1.0)
                    out[n, 3 * i : 3 * i + 3, v, u] = np.log(np.maximum(share, 1e-5) / np.maximum(1.0 - share, 1e-5))
    return torch.from_numpy(out)


def sine_input(cameras: int, height: int, width: int) -> Tensor:
    """(N, 384, H, W): camera, row, column; in each 64 sines, then 64 cosines."""
    out = np.zeros((cameras, 384, height, width))
    for n in range(cameras):
        for v in range(height):
            for u in range(width):
                for part, (place, count) in enumerate(((n, cameras), (v, height), (u, width))):
                    angle = (place + 1) / (count + 1e-6) * 2 * math.pi
                    for i in range(64):
                        out[n, 128 * part + i, v, u] = math.sin(angle / 10000 ** (2 * i / 128))
                        out[n, 128 * part + 64 + i, v, u] = math.cos(angle / 10000 ** (2 * i / 128))
    return torch.from_numpy(out)


def query_input(reference: Tensor) -> Tensor:
    """(Q, 384): y, x, z; sines and cosines alternate."""
    out = np.zeros((len(reference), 384))
    for part, axis in enumerate((1, 0, 2)):
        for i in range(64):
            angle = reference[:, axis].numpy() * 2 * math.pi / 10000 ** (2 * i / 128)
            out[:, 128 * part + 2 * i], out[:, 128 * part + 2 * i + 1] = np.sin(angle), np.cos(angle)
    return torch.from_numpy(out)


def mlp(state: State, name: str, x: Tensor) -> Tensor:
    """Two layers with ReLU; 1 x 1 convolutions are linear layers."""
    first, second = state[f"{name}.0.weight"], state[f"{name}.2.weight"]
    x = torch.relu(x @ first.flatten(1).T + state[f"{name}.0.bias"])
    return x @ second.flatten(1).T + state[f"{name}.2.bias"]


def attention(state: State, name: str, q: Tensor, k: Tensor, v: Tensor, heads: int = 8) -> Tensor:
    weight, bias = state[f"{name}.in_proj_weight"], state[f"{name}.in_proj_bias"]
    dim = q.shape[1]
    q, k, v = (x @ weight[i * dim : (i + 1) * dim].T + bias[i * dim : (i + 1) * dim] for i, x in enumerate((q, k, v)))
    size = dim // heads
    out = []
    for head in range(heads):
        part = slice(head * size, (head + 1) * size)
        score = q[:, part] @ k[:, part].T / math.sqrt(size)
        score = torch.exp(score - score.max(1, keepdim=True).values)
        out.append(score / score.sum(1, keepdim=True) @ v[:, part])
    return torch.cat(out, 1) @ state[f"{name}.out_proj.weight"].T + state[f"{name}.out_proj.bias"]


def norm(state: State, name: str, x: Tensor) -> Tensor:
    centred = x - x.mean(1, keepdim=True)
    scaled = centred / torch.sqrt((centred**2).mean(1, keepdim=True) + 1e-5)
    return scaled * state[f"{name}.weight"] + state[f"{name}.bias"]


def linear(state: State, name: str, x: Tensor) -> Tensor:
    return x @ state[f"{name}.weight"].T + state[f"{name}.bias"]


def petr(state: State, images: Tensor, projections: np.ndarray) -> tuple[Tensor, Tensor]:
    """Logits (Q, 10) and codes (Q, 10) of the last layer, for images (N, 3, H, W)."""
    features = neck(state, *vovnet(state, images))
    cameras, _, height, width = features.shape
    head = "pts_bbox_head"
    memory = F.conv2d(features, state[f"{head}.input_proj.weight"], state[f"{head}.input_proj.bias"])

    def tokens(maps: Tensor) -> Tensor:
        return maps.permute(0, 2, 3, 1).reshape(-1, maps.shape[1])

    memory = tokens(memory)
    position = mlp(
        state, f"{head}.position_encoder", tokens(position_input(projections, height, width, tuple(images.shape[2:])))
    )
    position = position + mlp(state, f"{head}.adapt_pos3d", tokens(sine_input(cameras, height, width)))
    reference = state[f"{head}.reference_points.weight"]
    query = mlp(state, f"{head}.query_embedding", query_input(reference))
    x = torch.zeros_like(query)
    decoder = f"{head}.transformer.decoder"
    for layer in range(6):
        base = f"{decoder}.layers.{layer}"
        x = norm(state, f"{base}.norms.0", x + attention(state, f"{base}.attentions.0.attn", x + query, x + query, x))
        x = norm(
            state, f"{base}.norms.1",
            x + attention(state, f"{base}.attentions.1.attn", x + query, memory + position, memory),
        )  # fmt: skip
        hidden = torch.relu(linear(state, f"{base}.ffns.0.layers.0.0", x))
        x = norm(state, f"{base}.norms.2", x + linear(state, f"{base}.ffns.0.layers.1", hidden))
    x = norm(state, f"{decoder}.post_norm", x)
    y = x
    for place in (0, 3):
        name = f"{head}.cls_branches.5"
        y = torch.relu(norm(state, f"{name}.{place + 1}", linear(state, f"{name}.{place}", y)))
    logits = linear(state, f"{head}.cls_branches.5.6", y)
    y = torch.relu(linear(state, f"{head}.reg_branches.5.0", x))
    code = linear(state, f"{head}.reg_branches.5.4", torch.relu(linear(state, f"{head}.reg_branches.5.2", y)))
    odds = torch.log(reference.clamp(min=1e-5) / (1 - reference).clamp(min=1e-5))
    code = code.clone()
    for slot, axis, low, high in ((0, 0, -51.2, 51.2), (1, 1, -51.2, 51.2), (4, 2, -5.0, 3.0)):
        code[:, slot] = 1 / (1 + torch.exp(-(code[:, slot] + odds[:, axis]))) * (high - low) + low
    return logits, code
