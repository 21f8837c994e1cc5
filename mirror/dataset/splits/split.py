"""Making and extending splits. A file ``splits/<name>.json`` is frozen once it is written."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from mirror.dataset.layout import Layout, require_dataset
from mirror.dataset.lock import writer_lock
from mirror.dataset.split_document import read_split
from mirror.dataset.splits import by_condition, by_list, by_scene, novel_traversal
from mirror.dataset.splits.assignment import Assignment
from mirror.dataset.splits.candidates import Candidates, read_candidates
from mirror.dataset.splits.leaks import Tie, find_leaks, find_ties
from mirror.dataset.store import Store
from mirror.errors import DatasetError, UsageError
from mirror.schema.documents import (
    ByCondition,
    ByList,
    ByScene,
    NovelTraversal,
    Role,
    SplitDocument,
    SplitMethod,
    is_identifier,
)
from mirror.schema.files import read_json, write_json
from mirror.schema.hashing import hash_document

_FEWER: Final = "ask for fewer with --train N --held-out-traversals M"


@dataclass(frozen=True)
class SplitReport:
    """The result of `make_split` or `extend_split`.

    Attributes:
        document: the split after the call.
        action: ``made``, ``kept`` (it existed already) or ``extended``.
        outside: traversals of the split's scenes that are in the dataset but not in the split.
        changed: traversals of the split that have been recorded again since, or are missing.
    """

    document: SplitDocument
    action: Literal["made", "kept", "extended"]
    outside: tuple[str, ...]
    changed: tuple[str, ...]

    def roles(self) -> dict[str, int]:
        """Return the number of traversals in each role."""
        return dict(Counter(self.document.assignments.values()))


def make_split(
    root: str | Path,
    name: str,
    parameters: SplitMethod | None = None,
    *,
    seed: int = 0,
    scenes: Sequence[str] | None = None,
    require: bool = False,
    replace: bool = False,
    wait: bool = False,
) -> SplitReport:
    """Assign a dataset's traversals to roles and freeze the result. An existing split is not changed.

    Args:
        root: the dataset's folder.
        name: name of the split.
        parameters: method and its parameters; None: `NovelTraversal`, the paper's 4 + 1.
        seed: random seed; the result does not depend on the order of ingest.
        scenes: the scenes to use; None: all.
        require: raise an error for a scene with too few traversals; False: leave it out.
        replace: replace an existing split.
        wait: True: wait for another writer; False: raise an error at once.

    Raises:
        UsageError: the name, a scene or the seed is invalid.
        DatasetError: the split would leak (the error names two traversals), a split of that name has other parameters,
            a role or scene gets too few traversals, or another run is writing.
        SchemaError: a file is broken or has another schema version.
    """
    layout = _dataset_layout(root)
    path = _path(layout, name)
    if seed < 0:
        raise UsageError(f"seed {seed}", expected="a whole number from 0")
    parameters = parameters or NovelTraversal()
    chosen = None if scenes is None else tuple(sorted(set(scenes)))
    with writer_lock(layout, wait=wait):
        candidates = read_candidates(layout)
        if path.is_file() and not replace:
            return _keep(read_json(path, SplitDocument), candidates, path, parameters, seed, chosen)
        _require_scenes(candidates, chosen)
        own = _of_scenes(candidates, chosen)
        found = find_ties(own, by_scene=isinstance(parameters, ByScene))
        assignment = _assign(own, found, parameters, seed)
        if require and assignment.left_out:
            place, reason = next(iter(assignment.left_out.items()))
            raise DatasetError(
                reason,
                file=layout.root,
                place=place,
                expected="a role for everything, as --require asks",
                remedy=f"record more, {_FEWER}, or leave --require out",
            )
        if not set(assignment.roles.values()) - {"unused"}:
            reasons = "; ".join(f"{key}: {reason}" for key, reason in list(assignment.left_out.items())[:3])
            raise DatasetError(
                f"no traversal gets a role ({reasons or 'the dataset has no traversals'})",
                file=layout.root,
                remedy=f"record more, or {_FEWER}",
            )
        _require_no_leak(found, assignment.roles, layout)
        document = _document(name, parameters, seed, chosen, own, assignment)
        write_json(path, document)
        return SplitReport(document, "made", (), ())


def extend_split(root: str | Path, name: str, *, wait: bool = False) -> SplitReport:
    """Add the traversals that are newer than a split to its train role. All other roles stay.

    Some new traversals are left out, and the document gives the reason. One that is tied to a traversal in another role
    (the same drive, image, vehicle and time, or ground) would leak. In a split by condition, one that matches no train
    condition is not added.

    Args:
        root: the dataset's folder.
        name: name of the split.
        wait: True: wait for another writer; False: raise an error at once.

    Raises:
        DatasetError: the split does not exist, or one of its traversals has been recorded again or is missing.
        SchemaError: a file is broken or has another schema version.
    """
    layout = _dataset_layout(root)
    path = _path(layout, name)
    with writer_lock(layout, wait=wait):
        candidates = read_candidates(layout)
        document = read_split(Store(root), name)
        outside, changed = compare(document, candidates)
        if changed:
            raise DatasetError(
                f"{len(changed)} traversals of the split have changed, such as {changed[0]}",
                file=path,
                expected="recorded traversals that never change",
                remedy=f"make the split again: mirror split {root} {name} --replace",
            )
        if not outside:
            return SplitReport(document, "kept", (), ())
        found = find_ties(_of_scenes(candidates, document.scenes), by_scene=isinstance(document.parameters, ByScene))
        left_out = _tied_elsewhere(outside, document.assignments, found)
        if isinstance(document.parameters, ByCondition):
            conditions = document.parameters
            unmatched = [
                key for key in outside if by_condition.role_of(candidates.traversals[key], conditions) != "train"
            ]
            left_out |= {key: f"{key} does not fit a train condition of the split" for key in unmatched}
        added: dict[str, Role] = {key: "unused" if key in left_out else "train" for key in outside}
        roles = {**document.assignments, **added}
        _require_no_leak(found, roles, layout)
        manifests = {**document.manifests, **{key: candidates.traversals[key].content for key in outside}}
        document = document.model_copy(
            update={
                "manifests": dict(sorted(manifests.items())),
                "dataset_hash": hash_manifests(manifests),
                "assignments": dict(sorted(roles.items())),
                "left_out": {**document.left_out, **left_out},
                "added": (*document.added, *outside),
            }
        )
        write_json(path, document)
        return SplitReport(document, "extended", (), ())


def compare(document: SplitDocument, candidates: Candidates) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Compare a split with the dataset: return the traversals newer than the split, and its changed ones, sorted."""
    own = _of_scenes(candidates, document.scenes).traversals
    outside = tuple(key for key in own if key not in document.manifests)
    changed = tuple(key for key, value in document.manifests.items() if key not in own or own[key].content != value)
    return outside, changed


def _dataset_layout(root: str | Path) -> Layout:
    layout = Layout(Path(root))
    require_dataset(layout)
    return layout


def _path(layout: Layout, name: str) -> Path:
    if not is_identifier(name):
        raise UsageError(f"{name!r} is not a valid name of a split", expected="letters, digits, `_` and `-`")
    return layout.split(name)


def _require_scenes(candidates: Candidates, scenes: Sequence[str] | None) -> None:
    unknown = sorted(set(scenes or ()) - set(candidates.scenes))
    if unknown:
        raise UsageError(
            f"unknown scene {unknown[0]!r}", place="--scene", expected=f"some of {', '.join(candidates.scenes)}"
        )


def _of_scenes(candidates: Candidates, scenes: Sequence[str] | None) -> Candidates:
    if scenes is None:
        return candidates
    own = {key: item for key, item in candidates.traversals.items() if item.scene_id in scenes}
    return Candidates(candidates.layout, candidates.scenes, own)


def _assign(candidates: Candidates, found: Sequence[Tie], parameters: SplitMethod, seed: int) -> Assignment:
    traversals = list(candidates.traversals.values())
    if isinstance(parameters, NovelTraversal):
        return novel_traversal.assign(traversals, found, parameters, seed)
    if isinstance(parameters, ByScene):
        return by_scene.assign(traversals, found, parameters, seed)
    if isinstance(parameters, ByList):
        return by_list.assign(traversals, found, parameters)
    return by_condition.assign(traversals, found, parameters)


def _document(
    name: str,
    parameters: SplitMethod,
    seed: int,
    scenes: tuple[str, ...] | None,
    candidates: Candidates,
    assignment: Assignment,
) -> SplitDocument:
    manifests = {key: item.content for key, item in sorted(candidates.traversals.items())}
    return SplitDocument(
        name=name,
        parameters=parameters,
        seed=seed,
        scenes=scenes,
        dataset_hash=hash_manifests(manifests),
        manifests=manifests,
        assignments=dict(sorted(assignment.roles.items())),
        left_out=dict(assignment.left_out),
    )


def hash_manifests(manifests: Mapping[str, str]) -> str:
    """Return the dataset hash of a split: SHA-256 over ids of traversals and hashes of their recorded data."""
    return hash_document(sorted(manifests.items()))


def _keep(
    document: SplitDocument,
    candidates: Candidates,
    path: Path,
    parameters: SplitMethod,
    seed: int,
    scenes: tuple[str, ...] | None,
) -> SplitReport:
    requested = {"parameters": parameters, "seed": seed, "scenes": scenes}
    for key, value in requested.items():
        existing = getattr(document, key)
        if existing != value:
            raise DatasetError(
                f"a split of this name was made with other {key}: {_text(existing)}",
                file=path,
                place=key,
                expected=_text(value),
                remedy="choose a new name, or replace it: --replace",
            )
    return SplitReport(document, "kept", *compare(document, candidates))


def _text(value: object) -> str:
    plain = value.model_dump(mode="json", exclude_none=True) if hasattr(value, "model_dump") else value
    return json.dumps(plain)


def _tied_elsewhere(outside: Sequence[str], roles: Mapping[str, Role], found: Sequence[Tie]) -> dict[str, str]:
    """Reasons why new traversals cannot be trained on, by id: ties to traversals with another role."""
    reasons: dict[str, str] = {}
    new = set(outside)
    for tie in found:
        other = next((key for key in tie.members if roles.get(key, "unused") not in ("unused", "train")), None)
        if other is not None:
            for key in tie.members:
                if key in new:
                    reasons.setdefault(key, f"{key} and {other} ({roles[other]}) {tie.reason}")
    return dict(sorted(reasons.items()))


def _require_no_leak(found: Sequence[Tie], roles: Mapping[str, Role], layout: Layout) -> None:
    """Raise an error if a split leaks. Every result is checked: an existing split may have been edited by hand."""
    across = find_leaks(found, roles)
    if across:
        raise DatasetError(
            f"the split leaks: {across[0]}" + (f" (and {len(across) - 1} more leaks)" if len(across) > 1 else ""),
            file=layout.root / "splits",
            expected="no drive, image, ground, or time of one vehicle in two roles",
            remedy="make the split again with --replace, or leave a scene out by naming the others with --scene",
        )
