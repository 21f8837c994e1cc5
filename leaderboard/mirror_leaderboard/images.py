"""A few renders and their truth, small, to look at on the board."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

import mirror
from mirror.arrays import UInt8
from mirror.evaluation.result import Result
from mirror.evaluation.submission.check import check_submission
from mirror.evaluation.submission.untrusted import open_untrusted
from mirror.protocols.png import decode_render, max_png_bytes
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views import Plan, RenderView, plan_views
from mirror.schema.files import write_bytes
from mirror_leaderboard.entry import Pair
from mirror_leaderboard.refused import RefusedError

_VIEWS: Final = 3
_WIDTH_PX: Final = 640
_JPEG_QUALITY: Final = 80


@dataclass(frozen=True)
class ImageSources:
    """Where pictures come from.

    Attributes:
        submission: folder or zip of renders.
        truth: the dataset.
    """

    submission: Path
    truth: Path


def copy_pairs(result: Result, submission: Path, truth: Path, pictures: Path) -> tuple[Pair, ...]:
    """Copy a few renders and their truth; of one plan always the same views, so that methods can be compared.

    Args:
        result: of the submission.
        submission: folder or zip.
        truth: the dataset.
        pictures: folder of the board's pictures.

    Raises:
        RefusedError: the submission or the dataset is not that of the result, or has no recorded truth.
        DatasetError: a picture cannot be read or written.
    """
    if result.protocol.task != "reconstruction":
        raise RefusedError(
            f"pictures of {result.protocol.name} have no recorded truth", remedy="add it without --submission"
        )
    plan = plan_views(mirror.open(truth), result.protocol, result.dataset.split)
    if plan.hash != result.dataset.plan_hash:
        raise RefusedError("is not the dataset that the result is of", file=truth, expected=result.dataset.plan_hash)
    files = open_untrusted(submission)
    if check_submission(files, plan).hash != result.submission_hash:
        raise RefusedError(
            "is not the submission that the result is of", file=submission, expected=result.submission_hash
        )
    source = GroundTruth(mirror.open(truth), result.protocol, plan.layers)
    folder, pairs = plan.hash[:16], []
    for number, view in enumerate(_chosen(plan)):
        data = files.read(view.path, max_png_bytes(view.width_px, view.height_px))
        render = decode_render(data, view.width_px, view.height_px, view.path)
        pair = Pair(
            view=f"{view.scene_id}, {view.camera}, {view.light}, {view.weather}, frame {view.frame_index}",
            render=f"{folder}/{number}-{result.hash[:12]}.jpg",
            truth=f"{folder}/{number}-recorded.jpg",
        )
        for name, pixels in ((pair.render, render), (pair.truth, source.image(view))):
            write_bytes(pictures / name, _jpeg(pixels))
        pairs.append(pair)
    return tuple(pairs)


def _chosen(plan: Plan) -> list[RenderView]:
    """Views of the rig's first camera, evenly through the protocol's last group that has any."""
    group = next(group.name for group in reversed(plan.protocol.groups) if group.name not in plan.empty_groups)
    views = [view for view in plan.views if view.group == group]
    views = [view for view in views if view.camera == views[0].camera]
    places = sorted({(2 * number + 1) * len(views) // (2 * _VIEWS) for number in range(_VIEWS)})
    return [views[place] for place in places]


def _jpeg(pixels: UInt8) -> bytes:
    height, width = pixels.shape[:2]
    if width > _WIDTH_PX:
        size = (_WIDTH_PX, round(height * _WIDTH_PX / width))
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
    return bytes(cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1])
