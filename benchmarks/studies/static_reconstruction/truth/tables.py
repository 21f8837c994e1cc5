"""What was measured, as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, TypeAlias

import numpy as np

from benchmarks.studies.static_reconstruction.truth.costs import PAPER_FPS, PAPER_MB, PAPER_SIZE

Measured: TypeAlias = dict[str, Any]
"""As `benchmarks.studies.static_reconstruction.truth.run` writes it down."""

_MOVED: Final = "moved_m"


def tables(found: Sequence[Measured]) -> str:
    """All tables; rows are means over the scenes and seeds of an entry."""
    parts = (
        ("Relative error of depth, median / 90 %", depth_table),
        ("Height of the ground, metres", ground_table),
        ("Edits of the light", light_table),
        ("Seams between blocks", seam_table),
        ("Costs", cost_table),
    )  # fmt: skip
    return "\n\n".join(f"### {title}\n\n{text}" for title, table in parts if (text := table(found)))


def depth_table(found: Sequence[Measured]) -> str:
    """A row an entry and group, a column a stretch of true depths."""
    stretches = {(row["from_m"], row["to_m"]): None for one in found for row in one["depth"]}
    keys = {(one["job"]["entry"], row["group"]): None for one in found for row in one["depth"]}

    def cell(entry: str, group: str, stretch: tuple[float, float]) -> str:
        own = [row for one in found if one["job"]["entry"] == entry for row in one["depth"]
               if row["group"] == group and (row["from_m"], row["to_m"]) == stretch]  # fmt: skip
        return " / ".join(f"{_mean(row[name] for row in own):.1%}" for name in ("median", "p90"))

    titles = [f"{low:g}-{high:g} m" for low, high in stretches]
    rows = [[entry, group, *(cell(entry, group, one) for one in stretches)] for entry, group in keys]
    return _markdown(["method", "views", *titles], rows)


def ground_table(found: Sequence[Measured]) -> str:
    """A row an entry and surface."""
    names = ("bias_m", "median_m", "p90_m")
    rows = _rows(
        found, "ground", "surface", names, lambda name, value: f"{value:+.3f}" if name == "bias_m" else f"{value:.3f}"
    )
    return _markdown(["method", "surface", "bias", "median error", "90 %"], rows)


def ceiling_table(found: Sequence[Measured]) -> str:
    """A row a scene, group, light and kind of poses, and their means over several scenes."""
    by_kind: dict[tuple[str, str, str], list[tuple[str, Measured]]] = {}
    for one in found:
        for row in one["ceiling"]:
            by_kind.setdefault((row["group"], row["light"], row["poses"]), []).append((one["scene"], row))
    rows = []
    for kind, own in sorted(by_kind.items()):
        mean = {name: _mean(row[name] for _, row in own) for name in ("psnr", "psnr_cc", "ssim")}
        pictures = sum(row["pictures"] for _, row in own)
        for scene, row in own if len(own) == 1 else (*own, ("mean", {**mean, "pictures": pictures})):
            numbers = (f"{row['psnr']:.2f}", f"{row['psnr_cc']:.2f}", f"{row['ssim']:.3f}", str(row["pictures"]))
            rows.append([*kind, scene, *numbers])
    return _markdown(["views", "light", "poses", "scene", "PSNR", "PSNR*", "SSIM", "pictures"], rows)


def light_table(found: Sequence[Measured]) -> str:
    """A row an entry and edit: what is edited, what is not, and the pictures that were recorded in that light."""
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


def seam_table(found: Sequence[Measured]) -> str:
    """A row a figure of each model."""
    rows = [
        [one["job"]["entry"], one["job"]["scene"], str(one["job"]["seed"]), row["name"], row["size"],
         f"{row['ms']:.2f}",
         "; ".join(f"{peer['name']} {peer['ms']:.2f}" for peer in row["peers"]) or "-"]
        for one in found for row in one["seam"]
    ]  # fmt: skip
    return _markdown(["method", "scene", "seed", "figure", "of", "value", "other"], rows)


def cost_table(found: Sequence[Measured]) -> str:
    """A row an entry, and the paper's."""
    names = ("fps", "wall_ms", "core_ms", "mb_per_100_m", "threads")
    rows = []
    for entry in {one["job"]["entry"]: None for one in found}:
        own = [one["costs"] for one in found if one["job"]["entry"] == entry]
        rows.append([entry, *(f"{_mean(row[name] for row in own):.4g}" for name in names)])
    rows.append(["paper, quoted", f"{PAPER_FPS:.4g} at {PAPER_SIZE}", "-", "-", f"{PAPER_MB:g}", "not stated"])
    width, height = found[0]["costs"]["size_px"] if found else (0, 0)
    titles = [f"pictures a second, {width} x {height}", "ms", "core ms", "MB a 100 m", "threads"]
    return _markdown(["method", *titles], rows if found else [])


def _rows(
    found: Sequence[Measured], part: str, key: str, names: Sequence[str], text: Callable[[str, float], str]
) -> list[list[str]]:
    """A row an entry and key: means of what has them, and the most that anything moves."""
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
    """Of those that are known; NaN of none."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else float("nan")


def _markdown(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    if not rows:
        return ""
    lines = [titles, ["---"] * len(titles), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
