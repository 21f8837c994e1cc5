"""Evaluation of rollouts by the protocol ``safety``: their state logs are scored, and the result is written."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from mirror.counting import count_of
from mirror.errors import UsageError
from mirror.evaluation.clusters import compute_clusters
from mirror.evaluation.result import IMAGES, RESULT, DatasetIdentity, Result
from mirror.evaluation.scorers.safety import ScoredRollout, rollout_figures, rollout_view, score_folder
from mirror.evaluation.submission.manifest import Appearance, SubmissionManifest, SubmittedMethod
from mirror.evaluation.versions import list_versions
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.document import Protocol
from mirror.protocols.suite import SuiteDrive, list_drives
from mirror.schema.files import write_bytes, write_json
from mirror.schema.folders import FolderKind, find_kind, require_output_folder
from mirror.schema.hashing import HashStyle, hash_document
from mirror.schema.rollout import BY_POLICY, MAP_FILE, ROLLOUT, SCENARIO_FILE, Rollout, read_rollout
from mirror.schema.scenario import encode_scenario

_OTHERS: Final = {
    FolderKind.DATASET: "a dataset, and no submission given",
    FolderKind.BUNDLE: "a published dataset, and no submission given",
    FolderKind.SUBMISSION: "a submission (of renders), and no dataset given",
}
"""Faults of folders that cannot hold rollouts, by their kind."""
_KEYS: Final = ("group", "scene_id", "traversal_id", "frame_index", "camera", "timestamp_ns", "light", "weather")


@dataclass(frozen=True)
class RolloutEvaluation:
    """The outcome of an evaluation of rollouts.

    Attributes:
        result: the written result.
        scored: the rollouts with their values.
    """

    result: Result
    scored: tuple[ScoredRollout, ...]


def evaluate_rollouts(
    folder: Path,
    protocol: Protocol,
    out: Path,
    progress: ProgressReporter | None = None,
    *,
    secret: bytes | None = None,
) -> RolloutEvaluation:
    """Score rollouts of one policy and write ``result.json`` and the table of their values.

    Args:
        folder: a rollout, or a folder with rollouts at any depth.
        protocol: a protocol of the task ``safety``.
        out: folder for the results.
        progress: receives the progress.
        secret: the organiser's secret of the suite; None: it has none.

    Raises:
        UsageError: the protocol has another task, there is no rollout, rollouts are of several policies or worlds, one
            was interrupted, or ``out`` is a folder of another kind.
        DatasetError: a rollout is incomplete or was changed, or the results cannot be written.
        SchemaError: a file of a rollout does not follow its schema.
    """
    progress = NullProgress() if progress is None else progress
    if protocol.task != "safety":
        raise UsageError(
            f"protocol {protocol.name} scores renders of a dataset, not rollouts",
            place="--protocol",
            expected="a protocol of the task safety",
            remedy="name the dataset and the submission: mirror evaluate DATASET SUBMISSION",
        )
    folders = find_rollouts(folder)
    require_output_folder(out, FolderKind.RESULTS)
    rollouts = {path: read_rollout(path) for path in folders}
    _require_one_policy(rollouts)
    if protocol.suite is not None:
        drives, renderer = list_drives(protocol.suite, secret), protocol.suite.renderer
        _require_whole_suite(rollouts, drives, renderer, protocol.name, folder)
    progress.start("scoring rollouts", len(rollouts))
    scored = []
    for path, rollout in rollouts.items():
        scored.append(score_folder(path, path.relative_to(folder).as_posix(), rollout, protocol))
        progress.advance(1)
    result = make_result(scored, protocol)
    write_bytes(out / IMAGES, _encode_table(scored, protocol))
    write_json(out / RESULT, result)
    return RolloutEvaluation(result, tuple(scored))


def _method_name(policy: str) -> str:
    """The name of a policy in results: without the folder of its file."""
    file, separator, member = policy.partition(".py:")
    return f"{PurePath(file).name}{separator}{member}" if separator else policy


def make_result(scored: Sequence[ScoredRollout], protocol: Protocol) -> Result:
    """Make the result of scored rollouts of one policy in one world."""
    identity, policy = _identify(scored), scored[0].rollout
    manifest = SubmissionManifest(
        protocol=protocol.name,
        protocol_hash=protocol.hash,
        split=identity.split,
        dataset_hash=identity.dataset_hash,
        plan_hash=identity.plan_hash,
        method=SubmittedMethod(name=_method_name(policy.policy), version=(policy.policy_hash or "1")[:12]),
        appearance=Appearance(policy="none"),
    )
    return Result(
        protocol=protocol,
        protocol_hash=protocol.hash,
        dataset=identity,
        submission=manifest,
        submission_hash=hash_document([one.rollout.hash for one in scored], HashStyle.CANONICAL),
        figures=tuple(rollout_figures(protocol, scored)),
        clusters=compute_clusters(protocol, _list_rows(scored, protocol)),
        unavailable={},
        weights={},
        versions=list_versions(),
        options={"world": policy.world, "road_map": ", ".join(sorted({_map_source(one) for one in scored}))},
        warnings=tuple(_list_warnings(scored, protocol)),
    )


def find_rollouts(folder: Path) -> list[Path]:
    """Find the rollouts in a folder, or that folder if it is one itself, in the order of their paths.

    Raises:
        UsageError: there is none, or the folder is a dataset or a submission.
    """
    if not folder.is_dir():
        problem = "a file, not a folder" if folder.exists() else "no such folder"
        raise UsageError(problem, file=folder, expected="a rollout of `mirror simulate`, or a folder of them")
    kind = find_kind(folder)
    if kind in _OTHERS:
        raise UsageError(
            _OTHERS[kind], file=folder, expected="mirror evaluate DATASET SUBMISSION, or a folder of rollouts alone"
        )
    found = [path.parent for path in sorted(folder.rglob(ROLLOUT)) if find_kind(path.parent) is FolderKind.ROLLOUT]
    if not found:
        raise UsageError(
            "holds no complete rollout",
            file=folder,
            expected=f"folders with {ROLLOUT}, which `mirror simulate` writes last",
        )
    return found


def _require_one_policy(rollouts: dict[Path, Rollout]) -> None:
    (first_path, first), *others = rollouts.items()
    for path, rollout in rollouts.items():
        if rollout.ending == "interrupted":
            raise UsageError("the rollout was interrupted", file=path, remedy="drive the scenario again")
    for name in ("policy", "policy_hash", "world", "model_hash", "dataset_hash"):
        for path, rollout in others:
            if getattr(rollout, name) != getattr(first, name):
                raise UsageError(
                    f"{name} is {getattr(rollout, name)!r}, but {getattr(first, name)!r} in {first_path}",
                    file=path,
                    expected="rollouts of one policy in one world",
                    remedy="evaluate them one policy and world at a time",
                )
    drives = [(rollout.scene_id, rollout.scenario, rollout.seed) for rollout in rollouts.values()]
    for path, drive in zip(rollouts, drives):
        if drives.count(drive) > 1:
            raise UsageError(
                f"scenario {drive[1]} with seed {drive[2]} was driven twice in scene {drive[0]}",
                file=path,
                expected="one rollout of each",
            )


def _require_whole_suite(
    rollouts: dict[Path, Rollout], drives: Sequence[SuiteDrive], renderer: str, name: str, folder: Path
) -> None:
    """Refuse rollouts that are not exactly the drives of a suite."""
    again = f"mirror simulate --suite {name} drives what is missing, in the same folder"
    asked = {drive.key: drive for drive in drives}
    given = {(one.scene_id, one.scenario, one.seed): path for path, one in rollouts.items()}
    for key, path in given.items():
        if key not in asked:
            raise UsageError(
                f"scenario {key[1]} with seed {key[2]} in scene {key[0]} is no drive of the suite {name}", file=path,
                expected="the drives of the suite alone", remedy="evaluate it by the protocol safety",
            )  # fmt: skip
        if rollouts[path].world != renderer:
            raise UsageError(f"its images are of {rollouts[path].world}", file=path, expected=renderer, remedy=again)
        fault = asked[key].sensors
        if rollouts[path].sensors != (None if fault is None else fault.name):
            raise UsageError(
                f"the fault of its sensors is {rollouts[path].sensors!r}", file=path / ROLLOUT,
                expected="none" if fault is None else repr(fault.name), remedy=again,
            )  # fmt: skip
        if (path / SCENARIO_FILE).read_bytes() != encode_scenario(asked[key].scenario):
            raise UsageError(
                "the scenario is not that of the suite", file=path / SCENARIO_FILE, expected=name, remedy=again
            )
    missing = [drive for key, drive in asked.items() if key not in given]
    if missing:
        raise UsageError(
            f"{count_of(len(missing), 'drive')} of {len(asked)} are missing, the first: {missing[0].folder}",
            file=folder, expected=f"all drives of the suite {name}", remedy=again,
        )  # fmt: skip


def _identify(scored: Sequence[ScoredRollout]) -> DatasetIdentity:
    """Identify what was driven: the world as the split, its data, the scenarios with their seeds as the plan."""
    first = scored[0].rollout
    maps = sorted({one.rollout.files[MAP_FILE].sha256 for one in scored})
    stated = first.dataset_hash or first.model_hash
    plan = sorted(
        [one.rollout.scene_id, one.rollout.files[SCENARIO_FILE].sha256, str(one.rollout.seed)] for one in scored
    )
    is_hash = stated is not None and re.fullmatch("[0-9a-f]{64}", stated) is not None
    maps_hash, plan_hash = (hash_document(one, HashStyle.CANONICAL) for one in (maps, [maps, plan]))
    dataset_hash = stated if stated and is_hash else maps_hash
    return DatasetIdentity(split=first.world, dataset_hash=dataset_hash, plan_hash=plan_hash)


def _map_source(scored: ScoredRollout) -> str:
    return scored.rollout.map_source or ("fitted" if scored.has_fitted_map else "not stated")


def _list_warnings(scored: Sequence[ScoredRollout], protocol: Protocol) -> list[str]:
    warnings = []
    fitted = sum(one.has_fitted_map for one in scored)
    if fitted:
        warnings.append(
            f"the road map of {fitted} of {len(scored)} rollouts was fitted to driven lines: nothing is known of where"
            " nobody drove, so that drivable margins are lower bounds"
        )
    failed = [one for one in scored if one.rollout.ending in BY_POLICY]
    if failed:
        # The folder itself may be the rollout.
        place = "" if failed[0].path == "." else f" {failed[0].path}:"
        score = "which are scored up to there"
        if protocol.suite is not None:
            score = f"whose PDMS and EPDMS are {protocol.suite.failed:g}"
        warnings.append(
            f"the policy failed in {len(failed)} of {len(scored)} rollouts, {score}; the first:"
            f"{place} {failed[0].rollout.reason or 'no reason given'}"
        )
    return warnings


def _list_rows(scored: Sequence[ScoredRollout], protocol: Protocol) -> list[dict[str, Any]]:
    """List one row a rollout; ``traversal_id`` is the scenario, ``frame_index`` the seed, ``camera`` the world."""
    rows = []
    for one in scored:
        view = rollout_view(one, protocol.groups[0].name)
        keys = {key: getattr(view, key) for key in _KEYS}
        causes = {f"{name}_cause": one.causes.get(name) for name in protocol.metric_names}
        ending = {"ending": one.rollout.ending, "steps": one.rollout.steps}
        rows.append({"path": one.path, **keys, **one.values, **ending, **causes})
    return rows


def _encode_table(scored: Sequence[ScoredRollout], protocol: Protocol) -> bytes:
    rows = _list_rows(scored, protocol)
    columns = {
        name: pa.array([row[name] for row in rows], pa.float64() if name in protocol.metric_names else None)
        for name in rows[0]
    }
    for name, column in columns.items():
        if pa.types.is_null(column.type):
            columns[name] = column.cast(pa.string())
    sink = io.BytesIO()
    table = pa.table(columns).replace_schema_metadata({"mirror_protocol_hash": protocol.hash})
    pq.write_table(table, sink, compression="zstd", version="2.6")
    return sink.getvalue()
