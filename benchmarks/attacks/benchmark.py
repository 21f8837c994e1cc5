"""The attack suite: what renders gain in the key when they are changed without showing more of the scene."""

from __future__ import annotations

import argparse
import hashlib
import inspect
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

import mirror
from benchmarks.attacks.changes import CHANGES, NOTHING, Material
from benchmarks.attacks.filters import apply_filter, find_filter
from mirror.arrays import Bool, UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import ExitCode, UsageError
from mirror.metrics.images.invariant import psnr_invariant
from mirror.metrics.images.matched_structure import matched_structure
from mirror.protocols.document import load_protocol
from mirror.protocols.png import decode_render
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views import Plan, RenderView, plan_views
from mirror.schema.files import write_bytes
from mirror_baselines import camera_mean, nearest_frame

PROTOCOL: Final = "static-reconstruction"
KEY: Final = "matched_structure"
FORMER_KEY: Final = "psnr_invariant"
METRICS: Final[Mapping[str, Callable[..., float]]] = {FORMER_KEY: psnr_invariant, KEY: matched_structure}
HONEST: Final = "honest"
FLOOR: Final = "nearest_frame"
BEST_FILTER: Final = "linear filter, best for the key"
BAR: Final = 0.1
"""Largest gain, as a part of the gap between the best and the worst row."""

_FORMAT: Final = "1"

Means = dict[str, float]
"""Mean of each metric."""


@dataclass(frozen=True)
class TrueView:
    """The truth of a view, and the images that a participant has beside the render."""

    view: RenderView
    truth: UInt8
    mask: Bool
    nearest: UInt8
    mean: UInt8

    def score(self, metric: str, image: UInt8) -> float:
        """Score an image by a metric."""
        return float(METRICS[metric](image, self.truth, mask=self.mask))


def main(argv: list[str]) -> int:
    """Attack the rows of each scene, and print what each attack gains; exit code 1 if one passes the bar."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks attacks", description=__doc__)
    parser.add_argument("dataset", help="folder of the dataset")
    parser.add_argument("row", nargs="*", metavar="NAME=SUBMISSION", help="renders of the split, of a trained method")
    parser.add_argument("--split", default="novel", help="name of the split (default: novel)")
    parser.add_argument("--scene", action="append", help="a scene; may be repeated (default: all)")
    parser.add_argument("--width", type=int, help="largest width of the renders, px (default: the protocol's)")
    parser.add_argument("--every", type=int, default=1, help="step between scored views (default: 1)")
    parser.add_argument("--out", type=Path, help="folder of finished scores, which another run reads (default: none)")
    arguments = parser.parse_args(argv)
    rows = dict(_split_row(text) for text in arguments.row)
    dataset = mirror.open(arguments.dataset)
    code = ExitCode.DONE
    for scene in arguments.scene or dataset.scenes():
        views = _read_views(dataset.where(scene=scene), arguments.split, arguments.width, arguments.every)
        found = {name: attack_row(views, _read_row(views, folder), arguments.out) for name, folder in rows.items()}
        found[FLOOR] = attack_row(views, [one.nearest for one in views], arguments.out)
        nothing = {name: _mean_scores(views, [change(_material(one, one.nearest)) for one in views])
                   for name, change in NOTHING.items()}  # fmt: skip
        print(f"\n## {scene}: {len(views)} views\n")
        print(format_tables(found, nothing), flush=True)
        if rows and any(largest > BAR for largest in largest_gains(found).values()):
            code = ExitCode.FINDINGS
    return code


def attack_row(views: Sequence[TrueView], renders: Sequence[UInt8], out: Path | None) -> dict[str, Means]:
    """Score a row as it is and under each attack.

    Args:
        views: (N,) views.
        renders: (N,) renders (H, W, 3).
        out: folder of finished scores; None: nothing is kept.

    Returns:
        The means of each metric by attack; the unchanged render is called `HONEST`.
    """
    file = None if out is None else out / f"{_hash_inputs(views, renders)}.json"
    if file is not None and file.is_file():
        known: dict[str, Means] = json.loads(file.read_text())
        return known
    found = {HONEST: _mean_scores(views, renders)}
    for name, change in CHANGES.items():
        found[name] = _mean_scores(views, [change(_material(one, image)) for one, image in zip(views, renders)])
    # Found on every second view, so that half of the views are new to it.
    seen, images = views[::2], renders[::2]
    shares = find_filter(images, lambda place, image: seen[place].score(KEY, image))
    found[BEST_FILTER] = _mean_scores(views, [apply_filter(image, shares) for image in renders])
    if file is not None:
        write_bytes(file, json.dumps(found, indent=1).encode())
    return found


def largest_gains(found: Mapping[str, Mapping[str, Means]]) -> dict[str, float]:
    """Return the largest gain in the key by row, as a part of the gap between the best and the worst trained row."""
    return {row: max(_find_gain(found, row, attack, KEY) for attack in by_attack) for row, by_attack in found.items()}


def find_gap(found: Mapping[str, Mapping[str, Means]], metric: str) -> float:
    """Return the difference of the best and the worst trained row in a metric; NaN with fewer than two rows."""
    values = [by_attack[HONEST][metric] for row, by_attack in found.items() if row != FLOOR]
    gap = max(values) - min(values) if len(values) > 1 else 0.0
    return gap if gap > 0.0 else float("nan")


def format_tables(found: Mapping[str, Mapping[str, Means]], nothing: Mapping[str, Means]) -> str:
    """Format the scores of rows and of renders that show nothing, and the largest gain of each attack."""
    lines = [f"| render | {' | '.join(METRICS)} |", f"|---|{'---|' * len(METRICS)}"]
    honest = {row: by_attack[HONEST] for row, by_attack in found.items()}
    lines += [f"| {name} | {_cells(means)} |" for name, means in {**honest, **nothing}.items()]
    trained = [row for row in found if row != FLOOR]
    heads = [f"{metric}: {rows}" for metric in METRICS for rows in ("trained rows", FLOOR)]
    lines += ["", "Largest gains, as percentages of the gap between the best and the worst trained row:", ""]
    lines += [f"| attack | {' | '.join(heads)} |", f"|---|{'---|' * len(heads)}"]
    for attack in found[FLOOR]:
        if attack != HONEST:
            gains = [
                max(_find_gain(found, row, attack, metric) for row in rows) if rows else math.nan
                for metric in METRICS
                for rows in (trained, [FLOOR])
            ]
            lines.append(f"| {attack} | {' | '.join(f'{100.0 * gain:+.1f}' for gain in gains)} |")
    return "\n".join(lines)


def _find_gain(found: Mapping[str, Mapping[str, Means]], row: str, attack: str, metric: str) -> float:
    """Return the gain of an attack for a row, as a part of the gap."""
    return (found[row][attack][metric] - found[row][HONEST][metric]) / find_gap(found, metric)


def _cells(means: Means) -> str:
    return f"{means[FORMER_KEY]:.2f} | {means[KEY]:.4f}"


def _split_row(text: str) -> tuple[str, Path]:
    name, equals, folder = text.partition("=")
    if not equals or not Path(folder).is_dir():
        raise UsageError(f"{text!r}", place="NAME=SUBMISSION", expected="a name and the folder of a submission")
    return name, Path(folder)


def _read_views(dataset: Dataset, split: str, width_px: int | None, every: int) -> list[TrueView]:
    protocol = load_protocol(PROTOCOL)
    if width_px is not None:
        pixels = protocol.pixels.model_copy(update={"max_width_px": width_px})
        protocol = protocol.model_copy(update={"pixels": pixels})
    whole = plan_views(dataset, protocol, split)
    ranking = protocol.ranking
    groups = () if ranking is None else ranking.groups
    plan = replace(whole, views=tuple([view for view in whole.views if view.group in groups][::every]))
    truth = GroundTruth(dataset, protocol, plan.layers)
    nearest, mean = _render_floor(nearest_frame, dataset, plan), _render_floor(camera_mean, dataset, plan)
    return [
        TrueView(view, truth.image(view), truth.scored_mask(view), nearest[view.path], mean[view.path])
        for view in plan.views
    ]


def _render_floor(floor: object, dataset: Dataset, plan: Plan) -> dict[str, UInt8]:
    return {view.path: np.asarray(image) for views, image in floor.render(dataset, plan) for view in views}  # type: ignore[attr-defined]


def _read_row(views: Sequence[TrueView], folder: Path) -> list[UInt8]:
    return [
        decode_render((folder / one.view.path).read_bytes(), one.view.width_px, one.view.height_px, one.view.path)
        for one in views
    ]


def _material(one: TrueView, render: UInt8) -> Material:
    return Material(render, one.nearest, one.mean)


def _mean_scores(views: Sequence[TrueView], images: Sequence[UInt8]) -> Means:
    return {
        metric: float(np.nanmean([one.score(metric, image) for one, image in zip(views, images)])) for metric in METRICS
    }


def _hash_inputs(views: Sequence[TrueView], renders: Sequence[UInt8]) -> str:
    """Hash everything that decides the scores of a row: images, masks, the metrics and the suite itself."""
    digest = hashlib.sha256(_FORMAT.encode())
    metrics = (inspect.getsourcefile(metric) for metric in METRICS.values())
    for source in sorted([*Path(__file__).parent.glob("*.py"), *(Path(file) for file in metrics if file)]):
        digest.update(source.read_bytes())
    for one, image in zip(views, renders):
        for array in (image, one.truth, one.mask, one.nearest, one.mean):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]
