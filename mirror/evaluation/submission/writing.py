"""Writes the renders of a method as a submission."""

from __future__ import annotations

import hashlib
import json
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, TypeAlias

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, MirrorError, UsageError
from mirror.evaluation.submission.manifest import MANIFEST, Appearance, Method, Runtime
from mirror.evaluation.submission.template import expected_files, manifest_for, write_manifest
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.png import encode_png
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import View
from mirror.schema.files import write_bytes

Render: TypeAlias = tuple[Sequence[View], UInt8]
"""A picture (H, W, 3), RGB, and the views that it is the render of."""

BEGUN: Final = ".rendering"
"""In a folder whose renders are not all there yet: a hash of what they are of."""

Renderer: TypeAlias = Callable[[Dataset, Plan], Iterable[Render]]
"""Renders every view of a plan once, in any order."""


def write_submission(
    dataset: Dataset,
    plan: Plan,
    renderer: Renderer,
    method: Method,
    appearance: Appearance,
    out: Path,
    progress: ProgressReporter | None = None,
    costs: Runtime | None = None,
    of: str | None = None,
) -> int:
    """Render a plan's views one by one and write them as a submission; the manifest is written last.

    Where it is said what the pictures are of, a run that was interrupted goes on: the renderer may leave out views
    whose files are there.

    Args:
        dataset: what the renderer may look at.
        plan: what is asked.
        renderer: makes the pictures; how many it makes a second goes into the manifest, without the first one of each
            scene, for which models are opened and kernels compiled.
        method: for the manifest.
        appearance: for the manifest.
        out: a new or an empty folder.
        progress: told of each view.
        costs: what is known of them besides the speed.
        of: what decides the pictures besides plan, method and appearance, such as the hash of a model.

    Returns:
        How many views the submission has.

    Raises:
        UsageError: the protocol asks for no renders, or the folder holds something.
        DatasetError: the folder cannot be written, or the renderer left views out.
    """
    expected = expected_files(plan)
    if not expected or None in expected.values():
        raise UsageError(f"protocol {plan.protocol.name} asks for no renders", expected="a protocol that does")
    begin_rendering(out, None if of is None else (plan.hash, repr(method), repr(appearance), of))
    progress = progress or NullProgress()
    progress.start("rendering", len(plan.views))
    there = sum((out / path).is_file() for path in expected)
    progress.advance(there)
    written, timed, taken, begin = 0, 0, 0.0, time.perf_counter()
    scene = None
    for views, picture in _nothing_left_behind(renderer(dataset, plan), out):
        if views[0].scene_id == scene:
            taken += time.perf_counter() - begin
            timed += len(views)
        data = encode_png(picture)
        for view in views:
            write_bytes(out / view.path, data)
        written, scene = written + len(views), views[0].scene_id
        progress.advance(len(views))
        begin = time.perf_counter()
    if there + written != len(expected):
        rendered = f"{there + written} of {len(expected)} views were rendered"
        raise DatasetError(rendered, file=out, expected="every view, once")
    runtime = costs or Runtime(device=f"{platform.machine()} CPU")
    if timed:
        runtime = runtime.model_copy(update={"frames_per_second": timed / max(taken, 1e-9)})
    write_manifest(out, manifest_for(plan, method, appearance, runtime))
    (out / BEGUN).unlink(missing_ok=True)
    return len(expected)


def _nothing_left_behind(renders: Iterable[Render], out: Path) -> Iterator[Render]:
    """Renders; the folder is as it was where not one of them can be made."""
    coming = iter(renders)
    try:
        first = next(coming, None)
    except MirrorError:
        if out.is_dir() and [path.name for path in out.iterdir()] == [BEGUN]:
            (out / BEGUN).unlink()
            out.rmdir()
        raise
    if first is not None:
        yield first
        yield from coming


def begin_rendering(out: Path, of: Sequence[str] | None) -> None:
    """See that a folder is new or empty, or that the same rendering was interrupted in it.

    Args:
        out: the folder; it is made.
        of: what decides the pictures; None: nothing goes on.

    Raises:
        UsageError: it holds something else.
        DatasetError: it cannot be written.
    """
    mark = hashlib.sha256(json.dumps(of).encode()).hexdigest()
    begun = out / BEGUN
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        if (out / MANIFEST).is_file():
            raise UsageError(
                "a submission is there already", file=out, remedy="take it, or name a new folder with --out"
            )
        if of is None or not begun.is_file():
            raise UsageError("not an empty folder", file=out, remedy="name a new one with --out")
        if begun.read_text() != mark:
            raise UsageError("renders of something else began here", file=out, remedy="name a new one with --out")
        return
    if of is not None:
        write_bytes(begun, mark.encode())
