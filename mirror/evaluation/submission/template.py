"""The template of a submission: pose, lens, size and mask of each expected file, and a manifest to fill in."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np

from mirror.evaluation.submission.manifest import (
    FORMAT_VERSION,
    MANIFEST,
    Appearance,
    Runtime,
    SubmissionManifest,
    SubmittedMethod,
)
from mirror.protocols.png import encode_png
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView
from mirror.schema.files import write_bytes, write_json
from mirror.schema.render_folder import finish_render_folder, start_render_folder

VIEWS: Final = "views.json"
README: Final = "README.md"
MASKS: Final = "masks/"

_README: Final = """# Submission to {protocol}, split {split}

{count} files are expected, listed in views.json: path, width and height, lens (fx, fy, cx, cy in pixels, the centre of
the first pixel at 0.5; OpenCV axes: x right, y down, z forward) and world_SE3_camera as qw qx qy qz tx ty tz in metres.
Renders are PNG, sRGB, 8 bit RGB, without alpha. `mask` is an image whose scored pixels are 255; if it is null, all
pixels are scored.
Fill in manifest.json: method.name, and appearance.policy, which is one of {policies}.
Then: mirror submission check DATASET THIS_FOLDER
"""


def expected_files(plan: Plan) -> dict[str, tuple[int, int] | None]:
    """Return the path of every file that a submission needs besides its manifest.

    The values are width and height of a render, and None for a table.
    """
    if plan.protocol.task == "runtime":
        return {}
    if plan.protocol.task == "annotation":
        return {detections_path(key): None for key in sorted({view.traversal_id for view in plan.views})}
    return {view.path: (view.width_px, view.height_px) for view in plan.views}


def detections_path(traversal_id: str) -> str:
    """Return the path of a traversal's boxes in a submission to an annotation protocol."""
    return f"detections/{traversal_id}.json"


def make_manifest(
    plan: Plan,
    method: SubmittedMethod,
    appearance: Appearance,
    runtime: Runtime | None = None,
    seed: int | None = None,
    notes: str = "",
) -> SubmissionManifest:
    """Make the manifest of a submission for a plan."""
    return SubmissionManifest(
        **_identify(plan), method=method, appearance=appearance, runtime=runtime, seed=seed, notes=notes
    )


def write_manifest(folder: Path, manifest: SubmissionManifest) -> None:
    """Write ``manifest.json``."""
    write_json(folder / MANIFEST, manifest)


def write_template(
    out: Path, plan: Plan, truth: GroundTruth, *, blind: bool = False, advance: Callable[[int], None] = lambda _: None
) -> int:
    """Write a template.

    Args:
        out: a new or an empty folder, or the folder of an interrupted call with the same arguments.
        plan: the requested views.
        truth: source of the masks; no image is read.
        blind: whether to leave out the addresses of the recorded images: for participants without the dataset.
        advance: called with 1 after each view.

    Returns:
        The number of expected files.

    Raises:
        UsageError: the folder holds other files.
        DatasetError: a mask is missing, or the folder cannot be written.
    """
    start_render_folder(out, ("template", plan.hash, str(blind)), last=MANIFEST)
    expected = expected_files(plan)
    rows = []
    for view in plan.views:
        rows.append(_write_row(out, view, truth, blind=blind, rendered=view.path in expected))
        advance(1)
    protocol = plan.protocol
    views = {"format": "mirror-views", "version": "1.0", **_identify(plan), "blind": blind, "views": rows}
    write_bytes(out / VIEWS, (json.dumps(views, indent=1) + "\n").encode())
    policies = ", ".join(get_args(Appearance.model_fields["policy"].annotation))
    readme = _README.format(protocol=protocol.name, split=plan.split, count=len(expected), policies=policies)
    write_bytes(out / README, readme.encode())
    blank = {"name": "", "version": "1", "authors": "", "url": "", "licence": "", "trained_on": ""}
    appearance = {"policy": "", "description": ""}
    manifest = {"format": "mirror-submission", "version": FORMAT_VERSION, **_identify(plan)}
    write_json(out / MANIFEST, {**manifest, "method": blank, "appearance": appearance, "runtime": None, "notes": ""})
    finish_render_folder(out)
    return len(expected)


def _identify(plan: Plan) -> dict[str, Any]:
    return {
        "protocol": plan.protocol.name,
        "protocol_hash": plan.protocol.hash,
        "split": plan.split,
        "dataset_hash": plan.dataset_hash,
        "plan_hash": plan.hash,
    }


def _write_row(out: Path, view: RenderView, truth: GroundTruth, *, blind: bool, rendered: bool) -> Mapping[str, Any]:
    row: dict[str, Any] = view.model_dump(mode="json")
    if not rendered:
        del row["path"]
    scored = truth.scored_mask(view)
    row["mask"] = None
    if rendered and not scored.all():
        row["mask"] = f"{MASKS}{view.path.removeprefix('renders/')}"
        write_bytes(out / row["mask"], encode_png(np.where(scored, 255, 0).astype(np.uint8)))
    if not blind:
        _, image = truth.recorded_frame_and_image(view)
        row["recorded"] = {
            "uri": image.uri,
            "byte_offset": image.byte_offset,
            "byte_length": image.byte_length,
            "sha256": None if image.sha256 is None else image.sha256.hex(),
        }
    return row
