"""Small copies of a few renders and their truth for the leaderboard."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np

import mirror
from mirror.arrays import UInt8
from mirror.evaluation.report import cover
from mirror.evaluation.result import Result
from mirror.evaluation.submission.untrusted import open_untrusted
from mirror.protocols.png import decode_render, max_png_bytes
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views import Plan, RenderView, plan_views
from mirror.schema.files import write_bytes
from mirror_leaderboard.entry import Pair
from mirror_leaderboard.rescore import Sources

_VIEWS: Final = 3
_WIDTH_PX: Final = 640
_JPEG_QUALITY: Final = 80


def copy_pairs(result: Result, sources: Sources, out: Path) -> tuple[Pair, ...]:
    """Copy a few renders and their truth; a plan determines the views, so that methods can be compared.

    Pixels outside the lens are grey in both, since nothing was recorded there.

    Args:
        result: result that was scored from the submission.
        sources: the submission and the dataset.
        out: folder of the board's images.

    Raises:
        DatasetError: an image cannot be read or written.
    """
    if sources.submission is None:
        return ()
    plan = plan_views(mirror.open(sources.dataset), result.protocol, result.dataset.split)
    files = open_untrusted(sources.submission)
    truth = GroundTruth(mirror.open(sources.dataset), result.protocol, plan.layers)
    folder, pairs = plan.hash[:16], []
    for number, view in enumerate(_select_views(plan)):
        data = files.read(view.path, max_png_bytes(view.width_px, view.height_px))
        render = decode_render(data, view.width_px, view.height_px, view.path)
        pair = Pair(
            view=f"{view.scene_id}, {view.camera}, {view.light}, {view.weather}, frame {view.frame_index}",
            render=f"{folder}/{number}-{result.hash[:12]}.jpg",
            truth=f"{folder}/{number}-recorded.jpg",
        )
        outside = truth.outside_lens(view)
        for name, pixels in ((pair.render, render), (pair.truth, truth.image(view))):
            write_bytes(out / name, _encode_jpeg(cover(pixels, outside)))
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
