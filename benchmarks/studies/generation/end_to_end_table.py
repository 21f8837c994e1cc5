"""The table of the addition: each bar's figure over exact and over reconstructed backgrounds, and what it loses."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from benchmarks.studies.generation.end_to_end import DISTANCES
from benchmarks.studies.generation.score_files import EMPTY
from benchmarks.studies.generation.study import Study

_Row = tuple[str, str, float, float, bool]
"""The quantity, the bar, both figures, and whether the loss is a ratio; other losses are positive if worse."""


def format_addition(study: Study, addition: Study) -> list[str]:
    """Return the lines of the addition; none until it is finished.

    Args:
        study: the study, with the figures over exact backgrounds.
        addition: the addition, see `end_to_end.open_addition`.
    """
    if addition.shown(DISTANCES) is None:
        return []
    return [
        "",
        f"Backgrounds of `mirror reconstruct` in place of the exact ones: addition `{addition.declaration.hash[:12]}`, "
        f"{sum(one.core_s for one in addition.outcomes.values()) / 60.0:.0f} core-minutes.",
        "",
        "| measured | bar | exact | reconstructed | loss |",
        "|---|---|---|---|---|",
        *(_format(row) for row in _list_rows(study, addition)),
        "",
        *_format_roads(addition),
    ]


def _format(row: _Row) -> str:
    name, bar, exact, found, is_ratio = row
    higher_is_better = bar.startswith(">=") or bar == "-"
    loss = f"x {found / exact:.2f}" if is_ratio else f"{exact - found if higher_is_better else found - exact:+.3g}"
    return f"| {name} | {bar} | {exact:.3g} | {found:.3g} | {loss} |"


def _list_rows(study: Study, addition: Study) -> Iterator[_Row]:
    bars, name = study.declaration.bars, f"on-{study.declaration.training['seeds'][0]}"
    both = [tuple(one.shown(stage) or {} for one in (study, addition)) for stage in (EMPTY, f"score-{name}", "edits")]
    empty, own, edits = both
    distances = addition.shown(DISTANCES) or {}

    def single(label: str, bar: str, figures: tuple[dict[str, Any], ...], key: str) -> _Row:
        exact, found = (one.get(key, math.nan) for one in figures)
        return (label, bar, exact, found, False)

    yield single("the background itself, outside the masks, dB", "-", empty, "db")
    yield single("background outside the masks, dB", f">= {bars['background_db']:g}", own, "db")
    yield single("drift of the background, dB", f"<= {bars['background_drift_db']:g}", own, "drift_db")
    found, exact = distances["image"]["distances"]
    yield ("image distance to the truth", "-", exact, found, True)
    yield (
        "crop distance, generated / exact background", f"<= {bars['crop_ratio']:g}",
        distances["crop_exact"]["value"], distances["crop"]["value"], False,
    )  # fmt: skip
    yield single("class of generated crops named", f">= {bars['classified']:g}", own, "classified")
    yield single("IoU at 0 m", f">= {bars['iou_0m']:g}", own, "iou")
    for metres in study.declaration.scoring["edits_m"]:
        moved = tuple(one.get(f"{metres:g}m", {}) for one in edits)
        yield single(f"IoU at {metres:g} m, normalised", f">= {bars[f'iou_{metres:g}m']:g}", moved, "normalised")
    yield single("identity: correlation of brightness", f">= {bars['identity']:g}", own, "correlation")
    yield single("identity kept at the end of a track", f">= {bars['identity_kept']:g}", own, "kept")


def _format_roads(addition: Study) -> list[str]:
    """One sentence on the reconstructions."""
    rendered = addition.shown("render") or {}
    roads = [
        (stage.removeprefix("reconstruct-"), one.figures)
        for stage, one in addition.outcomes.items()
        if stage.startswith("reconstruct-")
    ]
    if not rendered or not roads:
        return []
    trained = ", ".join(
        f"{name} {one['blocks']} blocks, {one['training_core_s'] / 60.0:.0f} core-minutes, {one['psnr_db']:.1f} dB"
        for name, one in roads
    )
    shift = ", ".join(f"{value:+.1f}" for value in rendered["shift"])
    return [
        f"The reconstructed backgrounds have {rendered['db']:.1f} dB against exact ones in all pixels; means differ by "
        f"{shift} of 255 steps (red, green, blue). Training, with the PSNR of its last images: {trained}.",
    ]
