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
from mirror.evaluation.submission.manifest import MANIFEST, MOST_FRAMES_PER_SECOND, Appearance, Runtime, SubmittedMethod
from mirror.evaluation.submission.template import expected_files, make_manifest, write_manifest
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.png import encode_png
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView
from mirror.schema.files import write_bytes
from mirror.schema.render_folder import UNFINISHED_MARK, finish_render_folder, start_render_folder

Render: TypeAlias = tuple[Sequence[RenderView], UInt8]
"""The views that one render belongs to, and its pixels (H, W, 3), RGB."""

Renderer: TypeAlias = Callable[[Dataset, Plan], Iterable[Render]]
"""A function that renders every view of a plan once, in any order."""


def write_submission(
    dataset: Dataset,
    plan: Plan,
    renderer: Renderer,
    method: SubmittedMethod,
    appearance: Appearance,
    out: Path,
    progress: ProgressReporter | None = None,
    costs: Runtime | None = None,
    of: str | None = None,
    notes: str = "",
) -> int:
    """Render a plan's views one by one and write them as a submission; the manifest is written last.

    With `of`, an interrupted run is continued: only views without a file are rendered.

    Args:
        dataset: the dataset, which the renderer may read.
        plan: the requested views.
        renderer: makes the images. The manifest states its speed without the first image of each scene, during which
            models are opened and kernels are compiled.
        method: entry of the manifest.
        appearance: entry of the manifest.
        out: a new or an empty folder.
        progress: receives the number of views and each finished view.
        costs: known costs of the method besides its speed.
        of: identifies everything that the images depend on besides plan, method and appearance, such as the hash of a
            model.
        notes: entry of the manifest.

    Returns:
        The number of views of the submission.

    Raises:
        UsageError: the protocol requests no renders, or the folder holds other files.
        DatasetError: the folder cannot be written, or the renderer left out views.
    """
    expected = expected_files(plan)
    if not expected or None in expected.values():
        raise UsageError(f"protocol {plan.protocol.name} requests no renders", expected="a protocol that does")
    start_render_folder(out, None if of is None else (plan.hash, repr(method), repr(appearance), of), last=MANIFEST)
    progress = progress or NullProgress()
    progress.start("rendering", len(plan.views))
    missing = tuple(view for view in plan.views if not (out / view.path).is_file())
    present = len(plan.views) - len(missing)
    progress.advance(present)
    written, timed, duration_s, begin = 0, 0, 0.0, time.perf_counter()
    scene = None
    for views, image in _remove_folder_on_early_error(renderer(dataset, replace(plan, views=missing)), out):
        if views[0].scene_id == scene:
            duration_s += time.perf_counter() - begin
            timed += len(views)
        data = encode_png(image)
        for view in views:
            write_bytes(out / view.path, data)
        written, scene = written + len(views), views[0].scene_id
        progress.advance(len(views))
        begin = time.perf_counter()
    if present + written != len(expected):
        rendered = f"{present + written} of {len(expected)} views were rendered"
        raise DatasetError(rendered, file=out, expected="every view, once")
    runtime = costs or Runtime(device=f"{platform.machine()} CPU")
    # Renders that take no measurable time have no speed.
    if timed and duration_s * MOST_FRAMES_PER_SECOND > timed:
        runtime = runtime.model_copy(update={"frames_per_second": timed / duration_s})
    write_manifest(out, make_manifest(plan, method, appearance, runtime, notes=notes))
    finish_render_folder(out)
    return len(expected)


def _remove_folder_on_early_error(renders: Iterable[Render], out: Path) -> Iterator[Render]:
    """Yield the renders; if the first one fails, remove a folder that holds nothing else."""
    remaining = iter(renders)
    try:
        first = next(remaining, None)
    except MirrorError:
        if out.is_dir() and [path.name for path in out.iterdir()] == [UNFINISHED_MARK]:
            finish_render_folder(out)
            out.rmdir()
        raise
    if first is not None:
        yield first
        yield from remaining
