"""Errors against exact truth as Markdown tables; rows are means over the scenes and seeds of an entry."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from benchmarks.studies.static_reconstruction.groups import Group
from benchmarks.studies.static_reconstruction.jobs import Job
from benchmarks.studies.static_reconstruction.records import EXACT_STREET_ROWS, Document
from benchmarks.studies.static_reconstruction.truth.costs import PAPER_FPS, PAPER_MB, PAPER_SIZE

_MOVED: Final = "moved_m"


def select_truth(truth: Sequence[Document], group: Group) -> list[Document]:
    """Return the records of models that a group shows, in the order of its rows."""
    found = [one for one in truth if group.has(Job(**one["job"]))]
    return sorted(found, key=lambda one: group.shown.index(one["job"]["entry"]))


def all_tables(found: Sequence[Document]) -> str:
    """Format all tables under their titles; the text is empty without records."""
    parts = ((_TITLES[name], table(found)) for name, table in TABLES.items())
    return "\n\n".join(f"### {title}\n\n{text}" for title, text in parts if text)


def depth_table(found: Sequence[Document]) -> str:
    """Return a row for each entry and group of views, a column for each range of true depths."""
    stretches = {(row["from_m"], row["to_m"]): None for one in found for row in one["depth"]}
    keys = {(one["job"]["entry"], row["group"]): None for one in found for row in one["depth"]}

    def cell(entry: str, group: str, stretch: tuple[float, float]) -> str:
        own = [row for one in found if one["job"]["entry"] == entry for row in one["depth"]
               if row["group"] == group and (row["from_m"], row["to_m"]) == stretch]  # fmt: skip
        return " / ".join(f"{_mean(row[name] for row in own):.1%}" for name in ("median", "p90"))

    titles = [f"{low:g}-{high:g} m" for low, high in stretches]
    rows = [[entry, group, *(cell(entry, group, one) for one in stretches)] for entry, group in keys]
    return _markdown(["method", "views", *titles], rows)


def ground_table(found: Sequence[Document]) -> str:
    """Return a row for each entry and surface."""
    names = ("bias_m", "median_m", "p90_m")
    rows = _rows(
        found, "ground", "surface", names, lambda name, value: f"{value:+.3f}" if name == "bias_m" else f"{value:.3f}"
    )
    return _markdown(["method", "surface", "bias", "median error", "90 %"], rows)


def exact_street_table(found: Sequence[Document], group: Group) -> str:
    """Return a row for each scene of a group, kind of views, light and kind of poses, and means over several scenes."""
    by_kind: dict[tuple[str, str, str], list[tuple[str, Document]]] = {}
    for one in found:
        if one["scene"] in group.scenes and one["width_px"] == group.width_px:
            for row in one[EXACT_STREET_ROWS]:
                by_kind.setdefault((row["group"], row["light"], row["poses"]), []).append((one["scene"], row))
    rows = []
    for kind, own in sorted(by_kind.items()):
        mean = {name: _mean(row[name] for _, row in own) for name in ("psnr", "psnr_cc", "ssim")}
        images = sum(row["pictures"] for _, row in own)
        for scene, row in own if len(own) == 1 else (*own, ("mean", {**mean, "pictures": images})):
            numbers = (f"{row['psnr']:.2f}", f"{row['psnr_cc']:.2f}", f"{row['ssim']:.3f}", str(row["pictures"]))
            rows.append([*kind, scene, *numbers])
    return _markdown(["views", "light", "poses", "scene", "PSNR", "PSNR*", "SSIM", "images"], rows)


def light_table(found: Sequence[Document]) -> str:
    """Return a row for each entry and edit: scores with and without the edit, and of images recorded in that light."""
    flat = [
        {"job": one["job"], "lighting": [_flat_edit(row) for row in one["lighting"]]} for one in found
    ]  # fmt: skip
    sorts = [(sort, metric) for metric in ("psnr", "psnr_cc", "ssim") for sort in ("edited", "unedited", "recorded")]
    names = [_MOVED, *(f"{sort} {metric}" for sort, metric in sorts)]

    def text(name: str, value: float) -> str:
        return f"{value:g}" if name == _MOVED else f"{value:.3f}" if name.endswith("ssim") else f"{value:.2f}"

    titles = [name.replace("psnr_cc", "PSNR*").replace("psnr", "PSNR").replace("ssim", "SSIM") for name in names[1:]]
    return _markdown(
        ["method", "edit", "depth moves by, m", *titles], _rows(flat, "lighting", "edit", names, text)
    )  # fmt: skip


def seam_table(found: Sequence[Document]) -> str:
    """Return a row for each figure of each model."""
    rows = [
        [one["job"]["entry"], one["job"]["scene"], str(one["job"]["seed"]), row["name"], row["size"],
         f"{row['ms']:.2f}",
         "; ".join(f"{peer['name']} {peer['ms']:.2f}" for peer in row["peers"]) or "-"]
        for one in found for row in one["seam"]
    ]  # fmt: skip
    return _markdown(["method", "scene", "seed", "figure", "of", "value", "other"], rows)


def cost_table(found: Sequence[Document]) -> str:
    """Return a row for each entry, and the paper's."""
    names = ("fps", "wall_ms", "core_ms", "mb_per_100_m", "threads")
    rows = []
    for entry in {one["job"]["entry"]: None for one in found}:
        own = [one["costs"] for one in found if one["job"]["entry"] == entry]
        rows.append([entry, *(f"{_mean(row[name] for row in own):.4g}" for name in names)])
    rows.append(["paper, quoted", f"{PAPER_FPS:.4g} at {PAPER_SIZE}", "-", "-", f"{PAPER_MB:g}", "not stated"])
    width, height = found[0]["costs"]["size_px"] if found else (0, 0)
    titles = [f"images a second, {width} x {height}", "ms", "core ms", "MB a 100 m", "threads"]
    return _markdown(["method", *titles], rows if found else [])


def _rows(
    found: Sequence[Document], part: str, key: str, names: Sequence[str], text: Callable[[str, float], str]
) -> list[list[str]]:
    """A row for each entry and key: means over the models that have it, and the largest `moved_m`."""
    keys = {(one["job"]["entry"], row[key]): None for one in found for row in one[part]}
    rows = []
    for entry, value in keys:
        own = [row for one in found if one["job"]["entry"] == entry for row in one[part] if row[key] == value]
        folded = {name: (max if name == _MOVED else _mean)(row[name] for row in own) for name in names}
        rows.append([entry, value, *(text(name, folded[name]) for name in names)])
    return rows


def _flat_edit(row: dict[str, Any]) -> dict[str, Any]:
    scores = {
        f"{sort} {metric}": value for sort in ("edited", "unedited", "recorded") for metric, value in row[sort].items()
    }
    return {"edit": row["edit"], _MOVED: row[_MOVED], **scores}


def _mean(values: Iterable[float | None]) -> float:
    """Mean of the values that are not None; NaN if all are."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else float("nan")


def _markdown(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    if not rows:
        return ""
    lines = [titles, ["---"] * len(titles), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


TABLES: Final[Mapping[str, Callable[[Sequence[Document]], str]]] = {
    "depth": depth_table,
    "ground": ground_table,
    "light": light_table,
    "seams": seam_table,
    "costs": cost_table,
}
"""By name."""
_TITLES: Final[Mapping[str, str]] = {
    "depth": "Relative error of depth, median / 90 %",
    "ground": "Height of the ground, metres",
    "light": "Edits of the light",
    "seams": "Seams between blocks",
    "costs": "Costs",
}
