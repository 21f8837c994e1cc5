"""Hosting of a method: the host checks the folder of a model, writes its document, and measures costs."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.methods.model_document import DOCUMENT, Costs, Reconstruction, list_trained_traversals, read_reconstruction
from mirror.methods.plugin import InstalledMethod, ReconstructionResult, ReconstructionTask
from mirror.methods.registry import method_label
from mirror.progress import ProgressReporter
from mirror.protocols.views.view import RenderView
from mirror.schema.files import write_json
from mirror.schema.folders import FolderKind, require_output_folder


def reconstruct(
    name: str,
    method: InstalledMethod,
    dataset: Dataset,
    task: ReconstructionTask,
    out: Path,
    progress: ProgressReporter,
) -> ReconstructionResult:
    """Train a model by a method, and write the ``reconstruction.json`` that rendering needs.

    Args:
        name: name of the method: an entry point, or ``FILE.py:OBJECT``.
        method: the method.
        dataset: dataset with the training images.
        task: scene, split, protocol and budget.
        out: folder of the model.
        progress: receives the progress.

    Returns:
        The method's result; costs that it does not state are measured here.

    Raises:
        UsageError: the folder holds something else, or the method returns no `ReconstructionResult`.
    """
    document = describe_task(method_label(name), dataset, task)
    require_own(out, document)
    is_new = not (out / DOCUMENT).exists()
    if is_new:
        # An interrupted training is recognised by it.
        write_json(out / DOCUMENT, document)
    wall_s, core_s = time.perf_counter(), time.process_time()
    try:
        result = method.reconstruct(dataset, task, out, progress)
        if not isinstance(result, ReconstructionResult):
            raise UsageError(
                f"reconstruct returned {type(result).__name__}", file=name, place="--method",
                expected="a mirror.methods.ReconstructionResult",
            )  # fmt: skip
    except BaseException:
        if is_new and [path.name for path in out.iterdir()] == [DOCUMENT]:
            (out / DOCUMENT).unlink()
            out.rmdir()
        raise
    result = replace(
        result,
        core_s=time.process_time() - core_s if result.core_s is None else result.core_s,
        wall_s=time.perf_counter() - wall_s if result.wall_s is None else result.wall_s,
        model_bytes=_model_bytes(out) if result.model_bytes is None else result.model_bytes,
        driven_m=driven_length_m(dataset.where(split=task.split, role="train", scene=task.scene))
        if result.driven_m is None
        else result.driven_m,
    )
    if not result.undone:
        write_costs(out, result)
    return result


def checked_renderer(name: str, render: Callable[[RenderView], UInt8]) -> Callable[[RenderView], UInt8]:
    """Wrap a renderer so that its images are checked.

    Args:
        name: name of the method, for messages.
        render: renderer of a method.

    Returns:
        A renderer that raises a `UsageError` where `render` returns something else than pixels of the view's size.

    Raises:
        UsageError: `render` is no function.
    """
    if not callable(render):
        raise UsageError(
            f"open returned {type(render).__name__}", file=name, place="--method",
            expected="a function from a mirror.methods.RenderView to its pixels", remedy=f"mend the method {name}",
        )  # fmt: skip

    def checked(view: RenderView) -> UInt8:
        pixels = render(view)
        shape = (view.height_px, view.width_px, 3)
        if not isinstance(pixels, np.ndarray) or pixels.dtype != np.uint8 or pixels.shape != shape:
            found = f"{pixels.dtype} {pixels.shape}" if isinstance(pixels, np.ndarray) else type(pixels).__name__
            raise UsageError(
                f"the renderer returned {found} for {view.path}", file=name, place="--method",
                expected=f"a numpy array of type uint8 and shape {shape}",
            )  # fmt: skip
        return pixels

    return checked


def describe_task(name: str, dataset: Dataset, task: ReconstructionTask) -> Reconstruction:
    """Make the document of a model that is not finished yet."""
    return Reconstruction(
        method=name,
        scene=task.scene,
        split=task.split,
        trained=list_trained_traversals(dataset, task.split, task.scene),
        withheld=len(task.withheld),
        poses=dataset.layers.poses,
        calibrations=dataset.layers.calibrations,
    )


def require_own(out: Path, document: Reconstruction) -> None:
    """Require that a folder is empty or already holds a model of the same task.

    Raises:
        UsageError: it holds something else.
    """
    if require_output_folder(out, FolderKind.MODEL) is None:
        return
    before = read_reconstruction(out)
    if before.model_copy(update={"done": None}) != document:
        raise UsageError(
            f"the folder holds a model of scene {before.scene}, split {before.split}, calibrations "
            f"{before.calibrations}, by {before.method}", file=out,
            remedy="name another folder with --out",
        )  # fmt: skip


def write_costs(out: Path, result: ReconstructionResult) -> None:
    """Write the costs into a model's document, which completes the model, unless it has costs already.

    Raises:
        DatasetError: the folder has no document.
    """
    document = read_reconstruction(out)
    if document.done is None:
        costs = Costs(
            model_bytes=result.model_bytes or 0, driven_m=result.driven_m or 0.0,
            core_s=result.core_s or 0.0, wall_s=result.wall_s or 0.0,
        )  # fmt: skip
        write_json(out / DOCUMENT, document.model_copy(update={"done": costs}))


def driven_length_m(dataset: Dataset) -> float:
    """Return the length in metres of the longest driven line of a dataset view's traversals.

    It is the road's length, if all of them drive along it.
    """
    lengths = [0.0]
    for traversal in dataset.traversals():
        frames = dataset.where(traversal=traversal).frames()
        if len(frames):
            places = frames[0].track[1].translation
            lengths.append(float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum()))
    return max(lengths)


def _model_bytes(out: Path) -> int:
    return sum(path.stat().st_size for path in out.rglob("*") if path.is_file() and path.name != DOCUMENT)
