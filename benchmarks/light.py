"""Error of trained models at places that nobody drove through, by light, and what exposure and headlights take off it.

``python -m benchmarks light DATASET --scene SCENE --split SPLIT --hidden FOLDER MODEL...``. The hidden truth is that of
the protocol lane-shift (`mirror submission hidden`). PSNR is that of the pixels inside the lens, without any fit of
colours. Of a model that knows its cameras' exposure the rows also show how far the gain that it chooses is from the
best one, and the PSNR at the mean exposure, at the best gain, and at the best gain without headlights.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor

import mirror
from benchmarks.report import Row, report
from hybridworldsim.methods.street import METHOD, StreetRenderer
from mirror.arrays import Bool, UInt8
from mirror.dataset.dataset import Dataset
from mirror.methods.appearance import AppearancePolicy
from mirror.metrics.images.psnr import psnr
from mirror.protocols.document import load_protocol
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views import Plan, plan_views
from mirror.protocols.views.view import RenderView

_GAINS: Final = np.linspace(-1.2, 1.2, 49)


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks light", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path, metavar="DATASET")
    parser.add_argument(
        "models", type=Path, nargs="+", metavar="MODEL", help="by hybridworldsim, its variants included"
    )
    parser.add_argument("--scene", required=True)
    parser.add_argument("--split", default="novel")
    parser.add_argument("--hidden", type=Path, required=True, help="hidden truth of the protocol lane-shift")
    parser.add_argument("--every", type=int, default=12, help="score one view of so many (default: 12)")
    given = parser.parse_args(argv)
    dataset = mirror.open(str(given.dataset))
    plan = plan_views(dataset.where(scene=given.scene), load_protocol("lane-shift"), given.split)
    rows = {str(model): _measure(model, dataset, plan, given.hidden, given.every) for model in given.models}
    return report("light", rows, errors="unused")


@torch.no_grad()
def _measure(model: Path, dataset: Dataset, plan: Plan, hidden: Path, every: int) -> Iterator[Row]:
    lit, dark = (METHOD.open(model, AppearancePolicy(views=plan.views, headlights=on)) for on in (True, False))
    truth = GroundTruth(dataset, plan.protocol, plan.layers, hidden)
    found: dict[str, list[Mapping[str, float]]] = {}
    for view in plan.views[::every]:
        found.setdefault(view.light, []).append(_score(lit, dark, view, truth.image(view), ~truth.outside_lens(view)))
    for light, scores in sorted(found.items()):
        for name in scores[0]:
            values = [score[name] for score in scores]
            middle = np.median(values) if name.startswith("gain") else np.mean(values)
            yield Row(f"{light}: {name}", f"{len(values)} images", float(middle))


def _score(lit: StreetRenderer, dark: StreetRenderer, view: RenderView, truth: UInt8, inside: Bool) -> dict[str, float]:
    def score(image: Tensor) -> float:
        levels = image.clamp(0.0, 1.0).mul(255.0).add(0.5).byte().numpy()
        return float(psnr(levels, truth, mask=inside))

    scores = {"PSNR, dB": score(lit.render(view).rgb)}
    chosen = lit.chosen_exposure(view)
    if chosen is None:
        return scores
    rendered, log_gain, respond = chosen
    best = max(_GAINS.tolist(), key=lambda gain: score(respond(rendered, gain)))
    without = dark.render_unexposed(view, None)[0].rgb
    return scores | {
        "PSNR at the mean exposure, dB": score(respond(rendered, 0.0)),
        "PSNR at the best gain, dB": score(respond(rendered, best)),
        "the same without headlights, dB": max(score(respond(without, gain)) for gain in _GAINS.tolist()),
        "gain against the best one, %": 100.0 * abs(float(np.exp(log_gain - best)) - 1.0),
    }
