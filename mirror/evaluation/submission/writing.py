"""Writes the renders of a method as a submission."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, MirrorError, UsageError
from mirror.evaluation.submission.manifest import MANIFEST, Appearance, Method, Runtime
from mirror.evaluation.submission.template import expected_files, make_manifest, write_manifest
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.png import encode_png
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView
from mirror.schema.files import write_bytes
from mirror.schema.render_folder import UNFINISHED_MARK, finish_render_folder, start_render_folder

Render: TypeAlias = tuple[Sequence[RenderView], UInt8]
"""A picture (H, W, 3), RGB, and the views that it is the render of."""

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

    Where it is said what the images are of, a run that was interrupted goes on: the renderer is asked for the views
    whose files are not there.

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
    start_render_folder(out, None if of is None else (plan.hash, repr(method), repr(appearance), of), last=MANIFEST)
    progress = progress or NullProgress()
    progress.start("rendering", len(plan.views))
    missing = tuple(view for view in plan.views if not (out / view.path).is_file())
    there = len(plan.views) - len(missing)
    progress.advance(there)
    written, timed, taken, begin = 0, 0, 0.0, time.perf_counter()
    scene = None
    for views, picture in _nothing_left_behind(renderer(dataset, replace(plan, views=missing)), out):
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
    write_manifest(out, make_manifest(plan, method, appearance, runtime))
    finish_render_folder(out)
    return len(expected)


def _nothing_left_behind(renders: Iterable[Render], out: Path) -> Iterator[Render]:
    """Renders; the folder is as it was where not one of them can be made."""
    coming = iter(renders)
    try:
        first = next(coming, None)
    except MirrorError:
        if out.is_dir() and [path.name for path in out.iterdir()] == [UNFINISHED_MARK]:
            finish_render_folder(out)
            out.rmdir()
        raise
    if first is not None:
        yield first
        yield from coming
