"""Writes the figures of the published studies by seed, as CSV, and the plots of their READMEs.

``python -m benchmarks published [--check]`` reads the outcomes that are committed; nothing is measured. With `--check`
no file is written, and the exit code is 1 if a table differs.
"""

from __future__ import annotations

import argparse
import csv
import io
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from matplotlib.figure import Figure

from mirror.errors import ExitCode
from mirror.schema.json_lines import decode_object, read_lines

STUDIES: Final = Path(__file__).with_name("studies")
Row = Mapping[str, str | int | float]


def format_tables() -> dict[str, str]:
    """Return the text of each file of figures by seed, by its path below the studies."""
    return {f"{name}/seeds.csv": format_csv(read()) for name, read in _TABLES.items()}


def format_csv(rows: Sequence[Row]) -> str:
    """Format rows with the same columns; floats have six significant digits."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({name: f"{value:.6g}" if isinstance(value, float) else value for name, value in row.items()})
    return text.getvalue()


def read_static_reconstruction() -> list[Row]:
    """Return a row for each training of the declared campaign."""
    from benchmarks.studies.static_reconstruction.tables import read_results

    outcomes = [one for one in _read("static_reconstruction") if (one["campaign"], one["kind"]) == ("main", "outcome")]
    results = [read_results([outcome])[0] for outcome in outcomes]
    rows: list[Row] = [
        {
            "method": result.job.entry,
            "street": result.job.scene,
            "seed": result.job.seed,
            "core_minutes": result.job.core_minutes,
            "width_px": result.job.width_px,
            **{name.replace(" ", "_"): float(value) for name, value in result.figures.items()},
        }
        for result in results
    ]
    return sorted(rows, key=lambda row: [str(row[name]) for name in ("method", "street", "core_minutes", "seed")])


def read_generation() -> list[Row]:
    """Return a row for each model and seed that was scored."""
    stages = {one["stage"]: one["figures"] for one in _read("generation")}
    names = ("db", "iou", "classified", "correlation", "kept", "seen_correlation", "seen_kept")
    rows: list[Row] = []
    for stage, figures in sorted(stages.items()):
        if found := re.fullmatch(r"score-(on|off)-(\d+)", stage):
            row: dict[str, str | int | float] = {
                "street_as_condition": "yes" if found[1] == "on" else "no",
                "seed": int(found[2]),
            }
            rows.append(row | {name: float(figures.get(name, float("nan"))) for name in names})
    return sorted(rows, key=lambda row: (str(row["street_as_condition"]) != "yes", row["seed"]))


def read_closed_loop() -> list[Row]:
    """Return a row for each world, policy and seed: means over the scenarios."""
    from benchmarks.studies.closed_loop.benchmark import OUTCOMES
    from benchmarks.studies.closed_loop.declaration import load_declaration
    from benchmarks.studies.closed_loop.records import Records
    from benchmarks.studies.closed_loop.report import CEILING, collect_rollouts
    from benchmarks.studies.closed_loop.stages import EXACT
    from benchmarks.studies.closed_loop.study import Study

    declaration = load_declaration()
    study = Study(Path("nowhere"), declaration, Records(OUTCOMES, declaration.hash))
    rows: list[Row] = []
    for world in (EXACT, CEILING, *study.plan().methods):
        for seed in study.plan().seeds:
            found = collect_rollouts(study, world, [seed])
            for index, policy in enumerate(declaration.policies):
                means = (found.score[index].mean(), found.collision[index].mean(), found.off_road[index].mean())
                row: dict[str, str | int | float] = {"world": world, "policy": policy, "seed": seed}
                rows.append(row | dict(zip(("score", "collisions", "off_road"), map(float, means), strict=True)))
    return rows


def read_annotation() -> list[Row]:
    """Return a row for each training and reference of the last declaration."""
    outcomes = _read("annotation")
    last = [one for one in outcomes if one["declaration"] == outcomes[-1]["declaration"]]
    rows: list[Row] = []
    for one in last:
        run = one.get("run") or one.get("checkpoint") or one.get("reference")
        row: dict[str, str | int | float] = {
            "run": str(run or f"{one['minutes']:g}min-seed{one['seed']}"),
            "core_minutes": one.get("core_s", 0.0) / 60,
            "mean_ap": one["mean_ap"],
        }
        row |= {f"ap_{metres}m": value for metres, value in one["ap"].items()}
        row |= {"position_m": one["translation_m"], "heading_rad": one["heading_rad"]}
        rows.append(row | {"mean_ap_known_scenes": one["known"]["mean_ap"]})
    return rows


def read_suite_policies() -> list[Row]:
    """Return a row for each policy, best first: the table of the study's README, which its benchmark prints."""
    text = (STUDIES / "suite_policies" / "README.md").read_text()
    interval, share = r"([\d.]+) \(([\d.]+) to ([\d.]+)\)", r"([\d.]+)"
    cells = rf"\| (\d+) \((\d+)-(\d+)\) \| `(\w+)` \| {interval} \| {share} \| {share} \| {share} \|"
    rows: list[Row] = []
    for rank, low, high, policy, *figures in re.findall(rf"^{cells}$", text, re.M):
        names = ("epdms", "epdms_low", "epdms_high", "collisions", "off_road", "progress")
        row: dict[str, str | int | float] = {"policy": policy, "rank": int(rank), "rank_low": int(low)}
        rows.append(row | {"rank_high": int(high)} | dict(zip(names, map(float, figures), strict=True)))
    return rows


_TABLES: Final[dict[str, Callable[[], list[Row]]]] = {
    "annotation": read_annotation,
    "closed_loop": read_closed_loop,
    "generation": read_generation,
    "static_reconstruction": read_static_reconstruction,
    "suite_policies": read_suite_policies,
}


def _read(study: str) -> list[dict[str, Any]]:
    return read_lines(STUDIES / study / "outcomes.jsonl", decode_object)


def draw_closed_loop() -> Figure:
    """Draw the score of each policy in another world over that in the exact one."""
    rows = read_closed_loop()
    figure = Figure(figsize=(5.2, 5.0), layout="constrained")
    axes = figure.add_subplot()
    exact = _mean_scores(rows, "exact")
    worlds = list(dict.fromkeys(str(row["world"]) for row in rows))[1:]
    for world, marker in zip(worlds, "o^sD", strict=True):
        scores = _mean_scores(rows, world)
        label = "exact, other noise" if world.startswith("exact") else world
        axes.plot(list(exact.values()), [scores[name] for name in exact], marker, label=label, alpha=0.8)
    bounds = (0.1, 0.6)
    axes.plot(bounds, bounds, color="grey", linewidth=0.8)
    axes.set(xlabel="score in the exact world (PDMS)", ylabel="score in another world", xlim=bounds, ylim=bounds)
    axes.legend(loc="upper left", fontsize=9)
    axes.grid(alpha=0.3)
    return figure


def _mean_scores(rows: Sequence[Row], world: str) -> dict[str, float]:
    scores: dict[str, list[float]] = {}
    for row in rows:
        if row["world"] == world:
            scores.setdefault(str(row["policy"]), []).append(float(row["score"]))
    return {policy: sum(values) / len(values) for policy, values in scores.items()}


def draw_annotation() -> Figure:
    """Draw average precision over core-minutes of training, beside the references without training."""
    rows = read_annotation()
    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    axes = figure.add_subplot()
    trained = [row for row in rows if "seed" in str(row["run"])]
    for metres, marker in (("4", "o"), ("2", "^"), ("1", "s")):
        (line,) = axes.plot(
            [row["core_minutes"] for row in trained], [row[f"ap_{metres}m"] for row in trained], marker,
            label=f"within {metres} m", alpha=0.8,
        )  # fmt: skip
        ground = next(float(row[f"ap_{metres}m"]) for row in rows if row["run"] == "ground")
        axes.axhline(ground, color=line.get_color(), linewidth=0.8, linestyle="--")
    axes.set(xlabel="core-minutes of training", ylabel="average precision of cars", xlim=(0, 13), ylim=(0, 1))
    title = "dashed: exact rectangles on the ground"
    figure.legend(loc="outside upper center", ncols=3, fontsize=9, title=title, title_fontsize=9, frameon=False)
    axes.grid(alpha=0.3)
    return figure


def draw_suite_policies() -> Figure:
    """Draw the score of each policy with its interval, best first."""
    rows = read_suite_policies()
    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    axes = figure.add_subplot()
    for place, row in enumerate(rows):
        axes.plot((row["epdms_low"], row["epdms_high"]), (place, place), color="tab:blue", linewidth=2, alpha=0.6)
        axes.plot(row["epdms"], place, "o", color="tab:blue")
    axes.set(xlabel="EPDMS, 95 % interval", xlim=(0, 1))
    _name_policies(axes, rows)
    return figure


def draw_suite_endings() -> Figure:
    """Draw what makes the scores: shares of drives with a collision and off the road, and the mean progress."""
    rows = read_suite_policies()
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    places = range(len(rows))
    for offset, name, label, colour in (
        (-0.2, "collisions", "collision", "tab:red"), (0.2, "off_road", "off the road", "tab:orange")
    ):  # fmt: skip
        left.barh([place + offset for place in places], [row[name] for row in rows], 0.38, label=label, color=colour)
    left.set(xlabel="share of drives", xlim=(0, 1))
    left.legend(fontsize=9, loc="upper right")
    right.barh(places, [row["progress"] for row in rows], 0.6, color="tab:blue")
    right.set(xlabel="mean progress, share of the possible", xlim=(0, 1))
    for axes in (left, right):
        _name_policies(axes, rows)
    return figure


def _name_policies(axes: Any, rows: Sequence[Row]) -> None:
    axes.set(yticks=range(len(rows)), yticklabels=[row["policy"] for row in rows], ylim=(len(rows) - 0.4, -0.6))
    axes.grid(alpha=0.3, axis="x")


_PLOTS: Final[dict[str, Callable[[], Figure]]] = {
    "annotation/budgets.png": draw_annotation,
    "closed_loop/scores.png": draw_closed_loop,
    "suite_policies/endings.png": draw_suite_endings,
    "suite_policies/scores.png": draw_suite_policies,
}


def main(argv: list[str]) -> int:
    """Write, or check, the tables; write the plots."""
    parser = argparse.ArgumentParser(prog="benchmarks published", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if a table differs")
    arguments = parser.parse_args(argv)
    tables = format_tables()
    if arguments.check:
        stale = [name for name, text in tables.items() if (STUDIES / name).read_text() != text]
        print("\n".join(f"{name} is not that of the outcomes" for name in stale) or "all tables are those of outcomes")
        return ExitCode.FINDINGS if stale else ExitCode.DONE
    for name, text in tables.items():
        (STUDIES / name).write_text(text)
        print(STUDIES / name)
    for name, draw in _PLOTS.items():
        draw().savefig(STUDIES / name, dpi=110, metadata={"Software": None})
        print(STUDIES / name)
    return ExitCode.DONE
