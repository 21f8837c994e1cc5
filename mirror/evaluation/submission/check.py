"""Checks a submission against a plan and lists all its problems."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, get_args

from mirror.evaluation.submission.manifest import MANIFEST, SubmissionManifest, read_manifest
from mirror.evaluation.submission.template import MASKS, README, VIEWS, expected_files
from mirror.evaluation.submission.untrusted import UntrustedError, UntrustedFiles
from mirror.pools import thread_pool
from mirror.protocols.png import RenderError, decode_render, find_png_problem, max_png_bytes, png_size
from mirror.protocols.views.plan import Plan

MAX_TABLE_BYTES: Final = 64 << 20
_THREADS: Final = 2
_OWN: Final = {MANIFEST, VIEWS, README}

Kind = Literal["manifest", "refused", "missing", "wrong size", "corrupt", "extra"]
"""The kinds of problems, in the order in which they are listed: causes before their consequences."""


@dataclass(frozen=True)
class SubmissionProblem:
    """One problem of a submission.

    Attributes:
        kind: kind of the problem.
        path: the file in the submission.
        message: what is wrong with the file.
    """

    kind: Kind
    path: str
    message: str


@dataclass(frozen=True)
class SubmissionCheck:
    """The result of a check.

    Attributes:
        expected: number of expected files.
        present: number of expected files that exist.
        problems: all problems, sorted by kind and path.
        manifest: the manifest; None if it cannot be read.
        hash: SHA-256 over the paths and contents of the manifest and the expected files that can be read, by path.
        hashes: SHA-256 of each of these files, by path; what is scored later must have the same.
        not_checked: what this check leaves out, each with the command that checks it.
    """

    expected: int
    present: int
    problems: tuple[SubmissionProblem, ...]
    manifest: SubmissionManifest | None
    hash: str
    hashes: Mapping[str, str] = field(default_factory=dict)
    not_checked: tuple[str, ...] = ()

    def counts(self) -> dict[str, int]:
        """Return the number of problems of each kind."""
        return dict(Counter(problem.kind for problem in self.problems))


def check_submission(
    files: UntrustedFiles, plan: Plan, *, decode: bool = False, advance: Callable[[int], None] = lambda _: None
) -> SubmissionCheck:
    """Check a submission.

    The size of each expected render is read from its PNG header, and the checksums of its PNG chunks are verified. A
    file that is not expected is never opened.

    Args:
        files: the submission.
        plan: the requested views.
        decode: whether to decode every image: pixel data can be incomplete although all checksums are right.
        advance: called with 1 after each checked file.
    """
    problems: list[SubmissionProblem] = []
    manifest, manifest_hash = None, ""
    try:
        manifest, manifest_hash = read_manifest(files)
    except UntrustedError as error:
        problems.append(SubmissionProblem("manifest", MANIFEST, _without_file(error)))
    else:
        problems += _find_manifest_problems(manifest, plan)
    expected = expected_files(plan)
    problems += [SubmissionProblem("refused", path, why) for path, why in files.refused.items()]
    problems += [
        SubmissionProblem("missing", path, "is not there")
        for path in expected
        if path not in files.sizes and path not in files.refused
    ]
    problems += [
        SubmissionProblem("extra", path, "is not expected, and was not opened")
        for path in files.sizes
        if path not in expected and path not in _OWN and not path.startswith(MASKS)
    ]
    present = [(path, size) for path, size in expected.items() if path in files.sizes]

    def check_and_advance(item: tuple[str, tuple[int, int] | None]) -> SubmissionProblem | str:
        problem_or_hash = _check_file(files, *item, decode=decode)
        advance(1)
        return problem_or_hash

    hashes = {} if manifest is None else {MANIFEST: manifest_hash}
    with thread_pool(_THREADS) as pool:
        for (path, _), problem_or_hash in zip(sorted(present), pool.map(check_and_advance, sorted(present))):
            if isinstance(problem_or_hash, SubmissionProblem):
                problems.append(problem_or_hash)
            else:
                hashes[path] = problem_or_hash
    order = get_args(Kind)
    problems.sort(key=lambda problem: (order.index(problem.kind), problem.path))
    not_checked = tuple(_list_not_checked([size for _, size in present], decode=decode))
    return SubmissionCheck(
        len(expected), len(present), tuple(problems), manifest, _hash_all(hashes), hashes, not_checked
    )


def _hash_all(hashes: Mapping[str, str]) -> str:
    digest = hashlib.sha256()
    for path in sorted(hashes):
        digest.update(json.dumps([path, hashes[path]]).encode())
    return digest.hexdigest()


def _list_not_checked(sizes: Sequence[tuple[int, int] | None], *, decode: bool) -> Iterator[str]:
    tables = sum(size is None for size in sizes)
    if len(sizes) > tables and not decode:
        yield f"the pixels of {len(sizes) - tables} images: `mirror submission check --decode` decodes them"
    if tables:
        yield f"the boxes in {tables} tables: `mirror evaluate` reads them"


def report_unreadable_manifest(files: UntrustedFiles, error: UntrustedError) -> SubmissionCheck:
    """Report on a submission whose manifest names no protocol or split, so that its expected files are unknown.

    Args:
        files: the submission.
        error: the problem of its manifest.
    """
    problems = [SubmissionProblem("manifest", MANIFEST, _without_file(error))]
    problems += [SubmissionProblem("refused", path, why) for path, why in sorted(files.refused.items())]
    return SubmissionCheck(0, 0, tuple(problems), None, "")


def _find_manifest_problems(manifest: SubmissionManifest, plan: Plan) -> list[SubmissionProblem]:
    expected = {
        "protocol": plan.protocol.name,
        "protocol_hash": plan.protocol.hash,
        "split": plan.split,
        "dataset_hash": plan.dataset_hash,
        "plan_hash": plan.hash,
    }
    problems = []
    if manifest.appearance.policy == "fitted" and plan.protocol.fitted_part is None:
        problem = f"appearance.policy is 'fitted', but protocol {plan.protocol.name} lets no appearance be fitted"
        problems.append(SubmissionProblem("manifest", MANIFEST, problem))
    return problems + [
        SubmissionProblem(
            "manifest", MANIFEST, f"{key} is {getattr(manifest, key)!r}, not {value!r}: made for another evaluation"
        )
        for key, value in expected.items()
        if getattr(manifest, key) != value
    ]


def _check_file(
    files: UntrustedFiles, path: str, size: tuple[int, int] | None, *, decode: bool
) -> SubmissionProblem | str:
    """Return the problem of a file, or its SHA-256 if it has none."""
    max_bytes = MAX_TABLE_BYTES if size is None else max_png_bytes(*size)
    if files.sizes[path] > max_bytes:
        return SubmissionProblem(
            "corrupt", path, f"has {files.sizes[path]:,} bytes; at most {max_bytes:,} can be needed"
        )
    try:
        data = files.read(path, max_bytes)
    except UntrustedError as error:
        return SubmissionProblem("corrupt", path, _without_file(error))
    if size is not None:
        actual = png_size(data)
        if actual is not None and actual != size:
            return SubmissionProblem(
                "wrong size", path, f"is {actual[0]} x {actual[1]} px, not {size[0]} x {size[1]} px"
            )
        problem = find_png_problem(data)
        if problem is not None:
            return SubmissionProblem("corrupt", path, problem)
        if decode:
            try:
                decode_render(data, *size, path)
            except RenderError as error:
                return SubmissionProblem("corrupt", path, error.problem)
    return hashlib.sha256(data).hexdigest()


def _without_file(error: UntrustedError) -> str:
    return error.problem + (f" ({error.remedy})" if error.remedy else "")
