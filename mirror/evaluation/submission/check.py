"""Holds a submission against what is expected of it: everything that is wrong, at once."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
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
"""In the order in which problems are listed: causes before what follows from them."""


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong.

    Attributes:
        kind: what sort of thing.
        path: the file in the submission.
        message: what is wrong with it.
    """

    kind: Kind
    path: str
    message: str


@dataclass(frozen=True)
class CheckReport:
    """What a check found.

    Attributes:
        expected: how many files are expected.
        present: how many of them are there.
        problems: all that is wrong, by kind and path.
        manifest: as read; None: it cannot be.
        hash: SHA-256 over the expected files that could be read, by path.
        not_checked: what was not looked at and may be wrong, with the way to check it.
    """

    expected: int
    present: int
    problems: tuple[Problem, ...]
    manifest: SubmissionManifest | None
    hash: str
    not_checked: tuple[str, ...] = ()

    def counts(self) -> dict[str, int]:
        """How many problems of each kind."""
        return dict(Counter(problem.kind for problem in self.problems))


def check_submission(
    files: UntrustedFiles, plan: Plan, *, decode: bool = False, advance: Callable[[int], None] = lambda _: None
) -> CheckReport:
    """Check a submission.

    Every expected render is held against its size and checksums by its header and chunks. No file that is not expected
    is opened.

    Args:
        files: the submission.
        plan: what was asked.
        decode: decode every image too: pixels may be missing between whole checksums.
        advance: told of each file that was looked at.
    """
    problems: list[Problem] = []
    manifest = None
    try:
        manifest = read_manifest(files)
    except UntrustedError as error:
        problems.append(Problem("manifest", MANIFEST, _without_file(error)))
    else:
        problems += _answers(manifest, plan)
    expected = expected_files(plan)
    problems += [Problem("refused", path, why) for path, why in files.refused.items()]
    problems += [
        Problem("missing", path, "is not there")
        for path in expected
        if path not in files.sizes and path not in files.refused
    ]
    problems += [
        Problem("extra", path, "is not expected, and was not opened")
        for path in files.sizes
        if path not in expected and path not in _OWN and not path.startswith(MASKS)
    ]
    there = [(path, size) for path, size in expected.items() if path in files.sizes]

    def look(item: tuple[str, tuple[int, int] | None]) -> Problem | str:
        found = _look(files, *item, decode=decode)
        advance(1)
        return found

    digest = hashlib.sha256()
    with thread_pool(_THREADS) as pool:
        for (path, _), found in zip(sorted(there), pool.map(look, sorted(there))):
            if isinstance(found, Problem):
                problems.append(found)
            else:
                digest.update(json.dumps([path, found]).encode())
    order = get_args(Kind)
    problems.sort(key=lambda problem: (order.index(problem.kind), problem.path))
    left = tuple(_not_checked([size for _, size in there], decode=decode))
    return CheckReport(len(expected), len(there), tuple(problems), manifest, digest.hexdigest(), left)


def _not_checked(sizes: Sequence[tuple[int, int] | None], *, decode: bool) -> Iterator[str]:
    tables = sum(size is None for size in sizes)
    if len(sizes) > tables and not decode:
        yield f"the pixels of {len(sizes) - tables} images: `mirror submission check --decode` decodes them"
    if tables:
        yield f"the boxes in {tables} tables: `mirror evaluate` reads them"


def report_unreadable_manifest(files: UntrustedFiles, error: UntrustedError) -> CheckReport:
    """What can be said of a submission that does not say what it answers: nothing is known to be expected.

    Args:
        files: the submission.
        error: why its manifest does not say.
    """
    problems = [Problem("manifest", MANIFEST, _without_file(error))]
    problems += [Problem("refused", path, why) for path, why in sorted(files.refused.items())]
    return CheckReport(0, 0, tuple(problems), None, "")


def _answers(manifest: SubmissionManifest, plan: Plan) -> list[Problem]:
    wanted = {
        "protocol": plan.protocol.name,
        "protocol_hash": plan.protocol.hash,
        "split": plan.split,
        "dataset_hash": plan.dataset_hash,
        "plan_hash": plan.hash,
    }
    return [
        Problem(
            "manifest", MANIFEST, f"{key} is {getattr(manifest, key)!r}, not {value!r}: made for another evaluation"
        )
        for key, value in wanted.items()
        if getattr(manifest, key) != value
    ]


def _look(files: UntrustedFiles, path: str, size: tuple[int, int] | None, *, decode: bool) -> Problem | str:
    """What is wrong with a file, or its SHA-256."""
    most = MAX_TABLE_BYTES if size is None else max_png_bytes(*size)
    if files.sizes[path] > most:
        return Problem("corrupt", path, f"has {files.sizes[path]:,} bytes; at most {most:,} can be needed")
    try:
        data = files.read(path, most)
    except UntrustedError as error:
        return Problem("corrupt", path, _without_file(error))
    if size is not None:
        there = png_size(data)
        if there is not None and there != size:
            return Problem("wrong size", path, f"is {there[0]} x {there[1]} px, not {size[0]} x {size[1]} px")
        problem = find_png_problem(data)
        if problem is not None:
            return Problem("corrupt", path, problem)
        if decode:
            try:
                decode_render(data, *size, path)
            except RenderError as error:
                return Problem("corrupt", path, error.problem)
    return hashlib.sha256(data).hexdigest()


def _without_file(error: UntrustedError) -> str:
    return error.problem + (f" ({error.remedy})" if error.remedy else "")
