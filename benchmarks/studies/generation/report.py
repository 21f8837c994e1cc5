"""The report of the study: tables for report.md."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from benchmarks.studies.generation import crops, end_to_end, end_to_end_table, published
from benchmarks.studies.generation.stages import list_stages
from benchmarks.studies.generation.study import Study
from benchmarks.studies.page import replace_section

PAGE: Final = Path(__file__).with_name("report.md")
BEGIN: Final = "<!-- generation study: written by `python -m benchmarks generation report` -->"
END: Final = "<!-- generation study: end -->"

_Row = tuple[str, str, str, str]
"""The quantity, the bar, the figure, and whether it is met: yes, no, void, or not run."""


def format_report(study: Study, addition: Study | None = None) -> str:
    """Format the section of the page, with its markers, and with a list of stages that have not run.

    Args:
        study: the study.
        addition: its addition, see `end_to_end`; None: without.
    """
    rows = list(_list_rows(study))
    stages = list_stages(study.declaration)
    left = [stage.name for stage in stages if stage.name not in study.outcomes]
    lines = [
        BEGIN,
        f"Declaration `{study.declaration.hash[:12]}`, {len(stages) - len(left)} of {len(stages)} stages, "
        f"{sum(one.core_s for one in study.outcomes.values()) / 3600.0:.1f} core-hours.",
        "",
        "| measured | bar | figure | met |",
        "|---|---|---|---|",
        *(f"| {' | '.join(row)} |" for row in rows),
        "",
        *_format_seeds(study),
        *_format_crops(study),
    ]
    if left:
        lines += [f"Not run: {', '.join(left)}.", ""]
    added = [] if addition is None else end_to_end_table.format_addition(study, addition)
    cut = {name: reason for name, reason in study.declaration.cut.items() if not (added and name == end_to_end.NAME)}
    lines += [f"Cut: {'; '.join(f'{name}: {reason}' for name, reason in cut.items())}.", *added, END]
    return "\n".join(lines)


_BY_SEED: Final = {
    "background, dB": ("db", ".2f"),
    "IoU at 0 m": ("iou", ".3f"),
    "class named": ("classified", ".3f"),
    "correlation": ("correlation", ".3f"),
    "kept": ("kept", ".3f"),
    "shown by the seeds: correlation": ("seen_correlation", ".3f"),
    "shown by the seeds: kept": ("seen_kept", ".3f"),
}
"""Figures of a model by the name of their column: its name in the score, and its format."""


def _format_seeds(study: Study) -> list[str]:
    """The figures of the models with background conditioning by the seed of their training, where there are several."""
    scores = {seed: study.shown(f"score-on-{seed}") for seed in study.declaration.training["seeds"]}
    shown = {seed: score for seed, score in scores.items() if score}
    if len(shown) < 2:
        return []
    return [
        "The model with background conditioning by the seed of its training; the bars above are those of the first.",
        "",
        f"| seed | {' | '.join(_BY_SEED)} |",
        f"|---|{'---|' * len(_BY_SEED)}",
        *(
            f"| {seed} | {' | '.join(format(score.get(key, math.nan), form) for key, form in _BY_SEED.values())} |"
            for seed, score in shown.items()
        ),
        "",
    ]


def _format_crops(study: Study) -> list[str]:
    """The table of crops by class and drive, for the models that were measured."""
    models = study.shown(crops.STAGE) or {}
    if not models:
        return []
    classes = sorted({name for figures in models.values() for name in figures["classes"]})
    lines = [
        "Crop distance, generated / empty background, by class; the worst and the second worst drive. Not declared.",
        "",
        f"| model | all | {' | '.join(classes)} | worst drive | second worst |",
        f"|---|{'---|' * (len(classes) + 3)}",
    ]
    for model, figures in models.items():
        drives = sorted(figures["drives"].values(), reverse=True)
        values = [figures["all"], *(figures["classes"].get(name, math.nan) for name in classes), *drives[:2]]
        lines.append(f"| {model} | {' | '.join(f'{value:.2f}' for value in values)} |")
    return [*lines, ""]


def update_page(study: Study, page: Path = PAGE, addition: Study | None = None) -> None:
    """Replace the section between the markers of a page; see `format_report`.

    Raises:
        UsageError: the page has no markers.
    """
    replace_section(page, BEGIN, END, format_report(study, addition))


def _list_rows(study: Study) -> Iterator[_Row]:
    bars, seed = study.declaration.bars, study.declaration.training["seeds"][0]
    least = int(study.declaration.scoring["least_samples"])
    judges, own, off = (study.shown(name) for name in ("judges", f"score-on-{seed}", f"score-off-{seed}"))
    noise, edits, steps = (study.shown(name) for name in ("score-noise", "edits", "score-distilled"))
    copy, vehicles = (study.shown(name) for name in ("background", "vehicles"))
    compared = [seed for seed in study.declaration.training["seeds"] if study.shown(f"conditioning-{seed}")]
    conditioning = study.shown(f"conditioning-{compared[-1]}") if compared else None
    seeds = "" if len(compared) < 2 else f", {len(compared)} seeds"
    yield _at_least("classifier on true crops", bars["classifier_on_truth"], judges, "classifier_accuracy")
    yield _at_least(
        "background outside the masks, dB",
        bars["background_db"],
        own,
        "db",
        _beside(own, "copy_db", "the empty street copied"),
    )
    yield _at_most(
        "drift of the background: loss against the copy in the last ten frames, less that in the first ten, dB",
        bars["background_drift_db"],
        own,
        "drift_db",
    )
    yield _at_least(
        "background without conditioning on it, next frame from recorded ones, dB (else void)",
        bars["off_background_db"],
        off,
        "next_db",
        _beside(off, "before_db", "the frame before copied") + _beside(off, "db", "rollout"),
    )
    for kind, name in (("image", f"image distance, on / off{seeds}"), ("motion", f"motion distance, on / off{seeds}")):
        bar = bars[f"{kind}_ratio"]
        if study.is_void():
            yield (name, f"upper end <= {bar:g}", "-", "void")
        else:
            found = conditioning if conditioning is None else conditioning.get(kind)
            yield _ratio(name, bar, found, least, upper=True)
    yield _ratio("crop distance, generated / empty background", bars["crop_ratio"], vehicles, least, most=1.0)
    yield _at_least(
        "class of generated crops named",
        bars["classified"],
        own,
        "classified",
        _beside(copy, "classified", "empty background"),
    )
    yield _at_least("IoU at 0 m", bars["iou_0m"], own, "iou", _beside(study.shown("truth"), "iou", "truth"))
    for metres in study.declaration.scoring["edits_m"]:
        one = None if edits is None else edits.get(f"{metres:g}m")
        note = (
            ""
            if not one or "floor" not in one
            else f" (IoU {one['iou']:.2f}, floor {one['floor']:.2f}, ceiling {one['ceiling']:.2f}, n {one['n']})"
        )
        yield _at_least(f"IoU at {metres:g} m, normalised", bars[f"iou_{metres:g}m"], one, "normalised", note)
    yield _at_least(
        "identity: correlation of brightness",
        bars["identity"],
        own,
        "correlation",
        _beside(copy, "correlation", "empty background")
        + _beside(own, "seen_correlation", "shown by the seeds")
        + _beside(noise, "correlation", "with noise on references"),
    )
    yield _at_least(
        "identity kept at the end of a track",
        bars["identity_kept"],
        own,
        "kept",
        _beside(own, "seen_kept", "shown by the seeds") + _beside(noise, "kept", "with noise on references"),
    )
    for kind in ("image", "crop"):
        one = None if steps is None else steps.get(kind)
        yield _ratio(
            f"{kind} distance, distilled / best teacher", bars["distilled"], one, least, most=bars["distilled_upper"]
        )
    for model, distances in (study.shown(published.STAGE) or {}).items():
        shown = ", ".join(f"{name.upper()} {value:.3g}" for name, value in distances.items())
        yield (f"{model}: FID and FVD", "-", shown, "-")


def _at_least(name: str, bar: float, figures: dict[str, Any] | None, key: str, note: str = "") -> _Row:
    return _single(name, f">= {bar:g}", figures, key, lambda value: value >= bar, note)


def _at_most(name: str, bar: float, figures: dict[str, Any] | None, key: str, note: str = "") -> _Row:
    return _single(name, f"<= {bar:g}", figures, key, lambda value: value <= bar, note)


def _single(name: str, bar: str, figures: dict[str, Any] | None, key: str, is_met: Any, note: str) -> _Row:
    if figures is None or figures.get("void"):
        return (name, bar, "-", "not run" if figures is None else "void")
    value = figures.get(key)
    if value is None or math.isnan(value):
        return (name, bar, f"none{note}", "no")
    return (name, bar, f"{value:.3g}{note}", "yes" if is_met(value) else "no")


def _ratio(
    name: str, bar: float, figures: dict[str, Any] | None, least: int, *, upper: bool = False, most: float | None = None
) -> _Row:
    """The row of a ratio of distances; it needs at least as many samples as declared."""
    text = f"upper end <= {bar:g}" if upper else f"<= {bar:g}" + ("" if most is None else f", upper end <= {most:g}")
    if figures is None or figures.get("void"):
        return (name, text, "-", "not run" if figures is None else "void")
    value, high = figures["value"], figures["high"]
    met = figures["n"] >= least and (high <= bar if upper else value <= bar and (most is None or high <= most))
    shown = f"{value:.3g} ({figures['low']:.3g} to {high:.3g}; n {figures['n']:,})"
    return (name, text, shown, "yes" if met else "no")


def _beside(figures: dict[str, Any] | None, key: str, name: str) -> str:
    value = None if figures is None else figures.get(key)
    return "" if value is None else f" ({name} {value:.3g})"
