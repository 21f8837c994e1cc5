"""Recoloured renders: what each attack on the colour fits of PSNR* and psnr_affine gains, and on psnr_invariant."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

import mirror
from mirror.arrays import Float64, UInt8
from mirror.metrics.images.affine import psnr_affine
from mirror.metrics.images.colour_correction import psnr_cc
from mirror.metrics.images.invariant import psnr_invariant
from mirror.protocols.document import load_protocol
from mirror.protocols.png import decode_render
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views import plan_views

Attack = Callable[[Float64], Float64]


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks colour_attacks", description=__doc__)
    parser.add_argument("row", nargs="+", metavar="DATASET=SUBMISSION", help="a dataset and renders of its split")
    parser.add_argument("--split", default="novel", help="name of the split (default: novel)")
    parser.add_argument("--every", type=int, default=2, help="step between scored views (default: 2)")
    arguments = parser.parse_args(argv)
    print("| row | views | attack | PSNR* | psnr_affine | psnr_invariant |\n|---|---|---|---|---|---|")
    for row in arguments.row:
        dataset, _, submission = row.partition("=")
        for scene, scores in _score(dataset, Path(submission), arguments.split, arguments.every).items():
            honest = np.mean(scores["honest"], axis=0)
            for name, values in scores.items():
                shown = honest if name == "honest" else np.mean(values, axis=0) - honest
                sign = "" if name == "honest" else "+"
                cells = " | ".join(f"{value:{sign}.3f}" for value in shown)
                print(f"| {scene}, {Path(submission).name} | {len(values)} | {name} | {cells} |", flush=True)
    return 0


def _score(dataset: str, submission: Path, split: str, every: int) -> Mapping[str, Mapping[str, list[list[float]]]]:
    """Scores of held-out views by scene and attack: PSNR*, psnr_affine and psnr_invariant."""
    protocol = load_protocol("static-reconstruction")
    opened = mirror.open(dataset)
    plan = plan_views(opened, protocol, split)
    truth = GroundTruth(opened, protocol, plan.layers)
    scores: dict[str, dict[str, list[list[float]]]] = {}
    for view in [view for view in plan.views if view.group == "novel"][::every]:
        data = (submission / view.path).read_bytes()
        render = decode_render(data, view.width_px, view.height_px, view.path).astype(np.float64)
        true, mask = truth.image(view), truth.scored_mask(view)
        for name, attack in ATTACKS.items():
            image = _to_levels(attack(render))
            found = [
                float(psnr_cc(image, true, mask=mask).db),
                float(psnr_affine(image, true, mask=mask).db),
                float(psnr_invariant(image, true, mask=mask)),
            ]
            scores.setdefault(view.scene_id, {}).setdefault(name, []).append(found)
    return scores


def _to_levels(image: Float64) -> UInt8:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _luma(image: Float64) -> Float64:
    return np.asarray(image @ np.array([0.299, 0.587, 0.114]))


def _ramps(image: Float64) -> tuple[Float64, Float64]:
    """Ramps (H, W) from 0 to 1 along columns and rows."""
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    return columns / image.shape[1], rows / image.shape[0]


def _in_all(image: Float64) -> Float64:
    return np.repeat(image[..., None], 3, axis=2)


def _ramps_and_luma(image: Float64) -> Float64:
    across, down = _ramps(image)
    return np.stack([10 + 230 * across, 10 + 230 * down, _luma(image)], axis=2)


def _luma_difference_ramp(image: Float64) -> Float64:
    return np.stack([_luma(image), 128 + (image[..., 2] - image[..., 0]) / 2, 10 + 230 * _ramps(image)[1]], axis=2)


def _with_sky(image: Float64) -> Float64:
    step = 1.0 / (1.0 + np.exp((_ramps(image)[1] - 0.45) * 12))
    return 0.8 * image + 55.0 * step[..., None]


ATTACKS: Final[Mapping[str, Attack]] = {
    "honest": lambda image: image,
    "x ramp, y ramp, luma": _ramps_and_luma,
    "luma, B - R, y ramp": _luma_difference_ramp,
    "luma in all channels": lambda image: _in_all(_luma(image)),
    "red in all channels": lambda image: _in_all(image[..., 0]),
    "green in all channels": lambda image: _in_all(image[..., 1]),
    "blue in all channels": lambda image: _in_all(image[..., 2]),
    "2 B - R in all channels": lambda image: _in_all(64 + image[..., 2] - image[..., 0] / 2),
    "20 levels brighter at the top": lambda image: image + 20 * (0.5 - _ramps(image)[1])[..., None],
    "a step like a sky": _with_sky,
    "doubled saturation": lambda image: 2 * image - _luma(image)[..., None],
}
