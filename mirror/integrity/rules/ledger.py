"""Rules of LED: the ledgers of passes, accepted and refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.integrity.dataset_view import DatasetView
from mirror.integrity.finding import Finding, Severity
from mirror.integrity.rows import TableRows
from mirror.integrity.rule import dataset_rule, scene_rule
from mirror.integrity.scene_view import SceneView
from mirror.schema.documents import TriggerOptions


@dataclass(frozen=True)
class Threshold:
    """One threshold of the trigger.

    Attributes:
        rule: its name in the ledger.
        column: the column that it tests.
        limit: the limit of the column.
        strict: True: the value must exceed the limit; False: it may equal the limit.
    """

    rule: str
    column: str
    limit: float
    strict: bool

    def met(self, passes: TableRows) -> Bool:
        """Mark (N,) where the figure fulfils the threshold."""
        figure = passes.floats(self.column)
        return figure > self.limit if self.strict else figure >= self.limit

    def __str__(self) -> str:
        return f"{self.column} {'above' if self.strict else 'at least'} {self.limit:g}"


def thresholds(trigger: TriggerOptions) -> tuple[Threshold, ...]:
    """Return thresholds in the order of the trigger's tests: the ledger names the first that fails."""
    return (
        Threshold("min_duration", "duration_s", trigger.min_duration_s, strict=False),
        Threshold("min_path", "path_m", trigger.min_path_m, strict=False),
        Threshold("min_overlap", "overlap", trigger.min_overlap, strict=True),
    )


def accepted(passes: TableRows) -> Bool:
    """Return a mask (N,), True where the decision is ``accepted``."""
    codes, words = passes.text_codes("decision")
    return np.isin(codes, [code for code, word in enumerate(words) if word == "accepted"])


def figures(passes: TableRows) -> dict[str, Float64]:
    """Return the measured columns of a ledger by name."""
    names = ("duration_s", "path_m", "inside_path_m", "overlap", "closest_m", "mean_speed_mps")
    return {name: passes.floats(name) for name in names}


@dataset_rule(
    "LED001",
    Severity.ERROR,
    title="An accepted pass does not fulfil the trigger's thresholds in dataset.json.",
    remedy="`mirror ingest RECORDING... --replace`: its ledger was written with other thresholds",
)
def _accepted_too_early(view: DatasetView) -> Iterator[Finding]:
    if view.document is None:
        return
    passes = view.passes
    for threshold in thresholds(view.document.trigger):
        yield from passes.findings(
            accepted(passes) & ~threshold.met(passes),
            lambda row, threshold=threshold: (  # type: ignore[misc]
                f"{threshold.column} is {passes.floats(threshold.column)[row]:g}; expected {threshold}"
            ),
        )


@dataset_rule(
    "LED002",
    Severity.ERROR,
    title=("A refused pass names another rule, figure or threshold than the first of the trigger's that it fails."),
    remedy="`mirror ingest RECORDING... --replace`: its ledger was written with other thresholds",
)
def _refused_wrongly(view: DatasetView) -> Iterator[Finding]:
    if view.document is None:
        return
    passes = view.passes
    codes, words = passes.text_codes("rule")
    refused = ~accepted(passes)
    expected = np.full(len(passes), "none", dtype=object)
    right = np.zeros(len(passes), np.bool_)
    undecided = refused.copy()
    for threshold in thresholds(view.document.trigger):
        fails = undecided & ~threshold.met(passes)
        named = np.isin(codes, [code for code, word in enumerate(words) if word == threshold.rule])
        same_figure = passes.floats("measured") == passes.floats(threshold.column)
        right |= fails & named & same_figure & (passes.floats("threshold") == threshold.limit)
        expected[fails] = f"{threshold.rule}: {threshold}"
        undecided &= ~fails
    yield from passes.findings(
        refused & ~right,
        lambda row: (
            f"refused by {passes.text('rule', row)}, measured {passes.floats('measured')[row]:g}, threshold"
            f" {passes.floats('threshold')[row]:g}; the first that it fails is {expected[row]}"
        ),
    )


_TOLERANCE = 1e-6


@dataset_rule(
    "LED003",
    Severity.ERROR,
    title="A pass's figures contradict each other: its duration, path, overlap, or speed.",
    remedy="`mirror ingest RECORDING... --replace`",
)
def _figures_agree(view: DatasetView) -> Iterator[Finding]:
    passes = view.passes
    found = figures(passes)
    span_s = (passes.integers("exit_ns") - passes.integers("entry_ns")) * 1e-9
    path, inside, overlap = found["path_m"], found["inside_path_m"], found["overlap"]
    wrong = {
        "a figure is not finite or negative": ~np.all([value >= 0 for value in found.values()], axis=0)
        | ~np.all([np.isfinite(value) for value in found.values()], axis=0),
        "duration_s is not exit_ns - entry_ns": np.abs(found["duration_s"] - span_s) > _TOLERANCE,
        "overlap is not from 0 to 1": ~((overlap >= 0) & (overlap <= 1)),
        "inside_path_m is more than path_m": inside > path * (1 + _TOLERANCE) + _TOLERANCE,
        "overlap is not inside_path_m / path_m": (path > 0) & (np.abs(overlap - inside / path) > _TOLERANCE),
        "mean_speed_mps is not path_m / duration_s": (span_s > 0)
        & (np.abs(found["mean_speed_mps"] - path / span_s) > _TOLERANCE * (1 + path / span_s)),
    }
    bad = np.any(list(wrong.values()), axis=0)
    yield from passes.findings(bad, lambda row: "; ".join(text for text, where in wrong.items() if where[row]))


_ON_THE_CIRCLE_M = 1e-3


@dataset_rule(
    "LED004",
    Severity.ERROR,
    title="A pass never comes within its scene's radius.",
    remedy="`mirror ingest RECORDING... --replace`, or restore the scene's circle in rois.geojson",
)
def _never_inside(view: DatasetView) -> Iterator[Finding]:
    passes = view.passes
    codes, words = passes.text_codes("scene_id")
    radius = np.array([view.scenes[word].radius_m if word in view.scenes else np.inf for word in words])[codes]
    closest = passes.floats("closest_m")
    yield from passes.findings(
        closest > radius + _ON_THE_CIRCLE_M,
        lambda row: f"closest to the centre at {closest[row]:.3f} m; expected at most {radius[row]:g} m",
        worst=closest,
    )


_SHARE = 0.01
_LEAST_M = 0.1


@scene_rule(
    "LED005",
    Severity.WARNING,
    title="The ledger's path is not the length of the recorded poses from entry to exit, by more than 1 %.",
    remedy="`mirror ingest RECORDING... --replace`; a drive in clips may count its path beyond the circle",
)
def _path_again(view: SceneView) -> Iterator[Finding]:
    if view.dataset.document is None:
        return
    trigger = view.dataset.document.trigger
    poses = view.poses
    for file, number, rows in poses.slices():
        passed = view.traversals[number].ledger_row
        stamps = poses.integers("timestamp_ns")[rows]
        entry, end = view.entry_ns[number], view.exit_ns[number]
        if passed is None or not view.has_valid_poses(rows) or not stamps[0] <= entry < end <= stamps[-1]:
            continue
        inside = np.flatnonzero((stamps > entry) & (stamps < end))
        at = (np.concatenate([[entry], stamps[inside], [end]]) - stamps[0]).astype(np.float64)
        seconds = (stamps - stamps[0]).astype(np.float64)
        x, y = (np.interp(at, seconds, poses.floats(name)[rows]) for name in ("tx_m", "ty_m"))
        sigma = np.nan_to_num(poses.floats("sigma_m")[rows], posinf=0.0)[inside]
        least = np.maximum(trigger.min_step_m, trigger.step_sigmas * np.concatenate([[0.0], sigma, [0.0]]))
        found, stated = counted_path(x, y, least), float(str(passed["path_m"]))
        if abs(found - stated) > max(_SHARE * max(found, stated), _LEAST_M):
            yield Finding(file, None, f"{found:.2f} m from entry to exit, but the ledger says {stated:.2f} m")


def counted_path(x: Float64, y: Float64, least: Float64) -> float:
    """Return the length of the line through the points that count.

    A point counts once it lies at least so far from the last one that counted.

    The last point always counts. All (N,), in metres.
    """
    steps = np.hypot(np.diff(x), np.diff(y))
    if (steps[:-1] >= least[1:-1]).all():
        return float(steps.sum())
    total, last_x, last_y = 0.0, x[0], y[0]
    for next_x, next_y, enough in zip(x[1:-1].tolist(), y[1:-1].tolist(), least[1:-1].tolist()):
        step = ((next_x - last_x) ** 2 + (next_y - last_y) ** 2) ** 0.5
        if step >= enough:
            total, last_x, last_y = total + step, next_x, next_y
    return float(total + np.hypot(x[-1] - last_x, y[-1] - last_y))


@dataset_rule(
    "LED006",
    Severity.ERROR,
    title=(
        "A pass is of another drive, or its traversal's id is not `scene.drive.entry_ms`, or a refused one has an id."
    ),
    remedy="`mirror ingest RECORDING... --replace`",
)
def _pass_identity(view: DatasetView) -> Iterator[Finding]:
    passes = view.passes
    expected_drive = [file.split("/")[-2] for file in passes.files]
    yes = accepted(passes)
    decision, words = passes.text_codes("decision")
    unknown = np.isin(decision, [code for code, word in enumerate(words) if word not in ("accepted", "refused")])
    why: dict[int, str] = {}
    columns = [passes.data.column(name).to_pylist() for name in ("scene_id", "drive_id", "traversal_id", "entry_ns")]
    for row, (scene, drive, traversal, entry_ns) in enumerate(zip(*columns)):
        name = f"{scene}.{drive}.{entry_ns // 1_000_000}"
        if unknown[row]:
            why[row] = f"decision is {words[decision[row]]!r}"
        elif drive != expected_drive[passes.owner[row]]:
            why[row] = f"drive_id is {drive!r}"
        elif traversal != (name if yes[row] else None):
            why[row] = (
                f"traversal_id is {traversal!r}; expected {name!r}" if yes[row] else f"refused, but {traversal!r}"
            )
        elif yes[row] and traversal not in view.named_traversals:
            why[row] = f"the drive's manifest does not name {traversal!r}"
    bad = np.zeros(len(passes), np.bool_)
    bad[list(why)] = True
    yield from passes.findings(bad, lambda row: why[row])
    there = {value for value in columns[2] if value is not None}
    read = {file.split("/")[-2] for file in passes.files}
    for traversal_id, (drive, _) in view.named_traversals.items():
        if drive in read and traversal_id not in there:
            yield Finding(f"drives/{drive}/passes.parquet", None, f"no accepted pass for traversal {traversal_id}")


@dataset_rule(
    "LED007",
    Severity.ERROR,
    title="Two passes of one drive through one scene overlap in time.",
    remedy="`mirror ingest RECORDING... --replace`",
)
def _overlapping_passes(view: DatasetView) -> Iterator[Finding]:
    passes = view.passes
    entry, end = passes.integers("entry_ns"), passes.integers("exit_ns")
    scene = passes.text_codes("scene_id")[0]
    order = np.lexsort((end, entry, scene, passes.owner))
    one, two = order[:-1], order[1:]
    again = (passes.owner[one] == passes.owner[two]) & (scene[one] == scene[two]) & (entry[two] < end[one])
    bad = np.zeros(len(passes), np.bool_)
    bad[two[again]] = True
    yield from passes.findings(
        bad, lambda row: f"begins before the exit of another pass, from {entry[row]} to {end[row]}"
    )
