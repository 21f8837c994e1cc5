"""Small copies of a few renders and their truth for the leaderboard."""

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
    """Sources of an entry's images.

    Attributes:
        submission: folder or zip of renders.
        truth: folder of the dataset.
    """

    submission: Path
    truth: Path


def copy_pairs(result: Result, sources: ImageSources, out: Path) -> tuple[Pair, ...]:
    """Copy a few renders and their truth; a plan determines the views, so that methods can be compared.

    Args:
        result: result of the submission.
        sources: the submission and the dataset.
        out: folder of the board's images.

    Raises:
        RefusedError: the submission or the dataset is not the one of the result, or the protocol has no recorded truth.
        DatasetError: an image cannot be read or written.
    """
    if result.protocol.task != "reconstruction":
        raise RefusedError(
            f"images of {result.protocol.name} have no recorded truth", remedy="add it without --submission"
        )
    plan = plan_views(mirror.open(sources.truth), result.protocol, result.dataset.split)
    if plan.hash != result.dataset.plan_hash:
        raise RefusedError("is not the dataset of the result", file=sources.truth, expected=result.dataset.plan_hash)
    files = open_untrusted(sources.submission)
    if check_submission(files, plan).hash != result.submission_hash:
        raise RefusedError(
            "is not the submission of the result", file=sources.submission, expected=result.submission_hash
        )
    truth = GroundTruth(mirror.open(sources.truth), result.protocol, plan.layers)
    folder, pairs = plan.hash[:16], []
    for number, view in enumerate(_select_views(plan)):
        data = files.read(view.path, max_png_bytes(view.width_px, view.height_px))
        render = decode_render(data, view.width_px, view.height_px, view.path)
        pair = Pair(
            view=f"{view.scene_id}, {view.camera}, {view.light}, {view.weather}, frame {view.frame_index}",
            render=f"{folder}/{number}-{result.hash[:12]}.jpg",
            truth=f"{folder}/{number}-recorded.jpg",
        )
        for name, pixels in ((pair.render, render), (pair.truth, truth.image(view))):
            write_bytes(out / name, _encode_jpeg(pixels))
        pairs.append(pair)
    return tuple(pairs)


def _select_views(plan: Plan) -> list[RenderView]:
    """Select views of the rig's first camera at even distances in the protocol's last group with views."""
    group = next(group.name for group in reversed(plan.protocol.groups) if group.name not in plan.empty_groups)
    views = [view for view in plan.views if view.group == group]
    views = [view for view in views if view.camera == views[0].camera]
    places = sorted({(2 * number + 1) * len(views) // (2 * _VIEWS) for number in range(_VIEWS)})
    return [views[place] for place in places]


def _encode_jpeg(pixels: UInt8) -> bytes:
    height, width = pixels.shape[:2]
    if width > _WIDTH_PX:
        size = (_WIDTH_PX, round(height * _WIDTH_PX / width))
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
    return bytes(cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1])
