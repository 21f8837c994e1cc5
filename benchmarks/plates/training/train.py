"""``python -m benchmarks.plates.training.train``: trains the detector of plates within a time limit.

It runs on a GPU where there is one. Weights are written every minute, as a moving average.
"""

from __future__ import annotations

import argparse
import copy
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from benchmarks.plates.training.loss import overlaps, plate_loss
from benchmarks.plates.training.network import PlateNetwork, decode, make_cells
from benchmarks.plates.training.stock import Stock


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.plates.training.train", description=__doc__)
    parser.add_argument("--glyphs", type=Path, required=True)
    parser.add_argument("--backgrounds", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True, help="folder of the weights")
    parser.add_argument("--seconds", type=float, default=400.0, help="limit of the wall clock, all included")
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--side", type=int, default=640)
    parser.add_argument("--slots", type=int, default=16000, help="samples that are kept")
    parser.add_argument("--workers", type=int, default=15)
    parser.add_argument("--rate", type=float, default=2e-3)
    parser.add_argument("--start", type=Path, help="weights to start from")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(argv)
    options.out.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    # Processes are forked before CUDA starts, which does not survive a fork.
    stock = Stock(options.glyphs, options.backgrounds, options.slots, options.side, options.workers, options.seed)
    checks = Stock(options.glyphs, options.backgrounds, 256, options.side, 1, 10_000 + options.seed)
    try:
        _train(options, stock, checks, began)
    finally:
        stock.close()
        checks.close()
    return 0


def _train(options: argparse.Namespace, stock: Stock, checks: Stock, began: float) -> None:
    torch.manual_seed(options.seed)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    on_gpu = device.type == "cuda"
    torch.backends.cudnn.benchmark = True
    network = PlateNetwork().to(device)
    if options.start is not None:
        network.load_state_dict(torch.load(options.start, map_location=device, weights_only=True))
    network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    average = copy.deepcopy(network).eval()
    decayed = [one for one in network.parameters() if one.ndim > 1]
    others = [one for one in network.parameters() if one.ndim <= 1]
    groups = [{"params": decayed, "weight_decay": 0.03}, {"params": others, "weight_decay": 0.0}]
    optimizer = torch.optim.AdamW(groups, lr=options.rate, betas=(0.9, 0.99), fused=on_gpu)
    while stock.full < min(4 * options.batch, options.slots):
        time.sleep(0.2)
    print(f"{time.monotonic() - began:.0f} s: {stock.made} samples, {device}", flush=True)
    step, saved, sums = 0, time.monotonic(), torch.zeros(2, device=device)
    limit = options.seconds - 12.0
    checked = None
    for images, boxes, states in stock.batches(options.batch, pinned=on_gpu):
        part = (time.monotonic() - began) / limit
        if part >= 1.0:
            break
        rate = options.rate * min(1.0, (step + 1) / 300) * (0.02 + 0.98 * 0.5 * (1.0 + math.cos(math.pi * part)))
        for group in optimizer.param_groups:
            group["lr"] = rate
        pixels, placed, state = _prepare(images, boxes, states, device)
        with torch.autocast(device.type, torch.bfloat16, enabled=on_gpu):
            raw = network(pixels)
        losses = plate_loss(raw, make_cells(pixels), placed, state == 1, state == 2)
        optimizer.zero_grad(set_to_none=True)
        (losses[0] + losses[1]).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimizer.step()
        sums += torch.stack([one.detach() for one in losses])
        step += 1
        _follow(average, network, min(0.999, (1 + step) / (20 + step)))
        if step % 100 == 0:
            now = time.monotonic()
            mean = (sums / 100).tolist()
            print(
                f"{now - began:.0f} s, step {step}: scores {mean[0]:.4f}, boxes {mean[1]:.4f}, rate {rate:.5f},"
                f" {stock.made} samples", flush=True,
            )  # fmt: skip
            sums.zero_()
        if time.monotonic() - saved > 60.0:
            saved = time.monotonic()
            _save(average, options.out)
            if checked is None and checks.full >= 256:
                checked = next(checks.batches(256, pinned=False, ahead=1))
                checks.close()
            if checked is not None:
                print(_check(average, checked, device), flush=True)
    _save(average, options.out)
    if checked is not None:
        print(_check(average, checked, device), flush=True)
    print(f"{time.monotonic() - began:.0f} s: {step} steps of {options.batch}, {stock.made} samples", flush=True)


def _prepare(images: Tensor, boxes: Tensor, states: Tensor, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Move a batch to the device, and change its scale, light and noise: a sample is drawn more than once."""
    pixels = images.to(device, non_blocking=True).permute(0, 3, 1, 2).float()
    placed, state = boxes.to(device, non_blocking=True), states.to(device, non_blocking=True)
    side = pixels.shape[2]
    scaled = int(
        np.random.choice([side, side, side, max(round(0.8 * side / 64) * 64, 64), max(round(0.6 * side / 64) * 64, 64)])
    )
    if scaled != side:
        pixels = functional.interpolate(pixels, size=(scaled, scaled), mode="bilinear", antialias=True)
        placed = placed * (scaled / side)
        state = torch.where((state == 1) & (placed[..., 2] - placed[..., 0] < 13.0), 2, state)
    count = len(pixels)
    gain = torch.exp(
        0.18 * torch.randn(count, 1, 1, 1, device=device) + 0.05 * torch.randn(count, 3, 1, 1, device=device)
    )
    offset = 12.0 * torch.randn(count, 1, 1, 1, device=device)
    sigma = 4.0 * torch.rand(count, 1, 1, 1, device=device) ** 2
    pixels = (pixels * gain + offset + sigma * torch.randn_like(pixels)).clamp(0.0, 255.0)
    return pixels.contiguous(memory_format=torch.channels_last), placed, state


@torch.no_grad()
def _follow(average: PlateNetwork, network: PlateNetwork, decay: float) -> None:
    """Move an average of the weights towards the present ones."""
    own = [one for one in average.state_dict().values() if one.is_floating_point()]
    new = [one for one in network.state_dict().values() if one.is_floating_point()]
    torch._foreach_lerp_(own, new, 1.0 - decay)


def _save(network: PlateNetwork, folder: Path) -> None:
    part = folder / "plates.pt.part"
    torch.save({name: one.cpu().contiguous() for name, one in network.state_dict().items()}, part)
    part.replace(folder / "plates.pt")


@torch.no_grad()
def _check(network: PlateNetwork, batch: tuple[Tensor, Tensor, Tensor], device: torch.device) -> str:
    """Recall at an overlap of 0.7 by width, and cells beside plates, at three scores, of samples without training."""
    lines: dict[float, list[list[int]]] = {score: [[0, 0] for _ in range(5)] for score in (0.2, 0.35, 0.5)}
    edges = torch.tensor([13.0, 32.0, 64.0, 192.0, 1e9])
    for first in range(0, len(batch[0]), 32):
        images, boxes, states = (part[first : first + 32] for part in batch)
        pixels = images.to(device).permute(0, 3, 1, 2).float().contiguous(memory_format=torch.channels_last)
        raw = network(pixels).float()
        found, scores = decode(raw, make_cells(pixels)).cpu(), raw[..., 4].sigmoid().cpu()
        for row in range(len(images)):
            true = boxes[row][states[row] == 1]
            known = boxes[row][states[row] > 0]
            for score, counts in lines.items():
                own = found[row][scores[row] > score]
                pairs = _pairs(own, true)
                for number, width in enumerate((true[:, 2] - true[:, 0]).tolist()):
                    place = int(torch.bucketize(width, edges, right=True)) - 1
                    counts[place][0] += bool(len(own)) and bool((pairs[:, number] > 0.7).any())
                    counts[place][1] += 1
                near = _pairs(own, known)
                counts[4][0] += int((near.amax(dim=1) < 0.2).sum()) if len(known) else len(own)
                counts[4][1] += 1
    return "\n".join(
        f"  score {score}: "
        + ", ".join(f"{a}/{b}" for a, b in counts[:4])
        + f"; cells beside {counts[4][0]}/{counts[4][1]}"
        for score, counts in lines.items()
    )


def _pairs(first: Tensor, second: Tensor) -> Tensor:
    count = len(first), len(second)
    flat = (first[:, None].expand(*count, 4).reshape(-1, 4), second[None].expand(*count, 4).reshape(-1, 4))
    return overlaps(*flat)[0].reshape(count)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
