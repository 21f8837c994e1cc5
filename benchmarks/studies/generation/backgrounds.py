"""Backgrounds of a clip from a static model: rendered at its cameras and poses, larger than the clip, and averaged."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from hybridworldsim.generation.clips.clip import Clip
from mirror.arrays import UInt8
from mirror.errors import DatasetError
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.protocols.views.view import RenderView

_GROUP: Final = "clip"
_AGREE_M: Final = 1e-3


def render_backgrounds(
    clip: Clip,
    world_SE3_ego: Poses,
    render: Callable[[RenderView], UInt8],
    *,
    traversal_id: str,
    scene_id: str,
    factor: int,
) -> UInt8:
    """Render the street at every view of a clip.

    Args:
        clip: the clip, for its cameras.
        world_SE3_ego: poses of the vehicle in the world of the model, one for each frame.
        render: the model, from a view to its pixels (H, W, 3).
        traversal_id: training traversal whose appearance the renders get.
        scene_id: scene of the model.
        factor: renders are so many times larger than the clip; their means are returned.

    Returns:
        (F, V, H, W, 3).

    Raises:
        DatasetError: the poses are not those of the clip.
    """
    _require_poses_of(clip, world_SE3_ego)
    height, width = clip.size_px
    images = np.zeros((len(clip), len(clip.views), height, width, 3), np.uint8)
    for frame in range(len(clip)):
        for number, view in enumerate(clip.views):
            pose = world_SE3_ego[frame : frame + 1] @ Poses.from_matrix(clip.ego_SE3_camera[number : number + 1])
            rendered = render(
                RenderView(
                    path=f"{_GROUP}/{clip.clip_id}/{view}/{frame}.png",
                    group=_GROUP,
                    scene_id=scene_id,
                    traversal_id=traversal_id,
                    frame_index=frame,
                    camera=view,
                    timestamp_ns=round(frame / clip.rate_hz * 1e9),
                    light="day",
                    weather="clear",
                    **_camera(clip, number, factor).to_row(),
                    world_SE3_camera=pose,
                )
            )
            parts = rendered.reshape(height, factor, width, factor, 3).astype(np.float64)
            images[frame, number] = np.rint(parts.mean(axis=(1, 3)))
    return images


def _camera(clip: Clip, view: int, factor: int) -> Camera:
    (height, width), lens = clip.size_px, clip.intrinsics[view]
    fx, fy, cx, cy = (float(lens[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    camera = Camera("pinhole", width, height, fx, fy, cx, cy)
    return camera.resized(factor * width, factor * height)


def _require_poses_of(clip: Clip, world_SE3_ego: Poses) -> None:
    """Require that the vehicle moves through the world as through the clip."""
    start_SE3_ego = world_SE3_ego[np.zeros(len(world_SE3_ego), np.int64)].inverse() @ world_SE3_ego
    matrices = start_SE3_ego.matrix()
    apart = np.abs(matrices - clip.start_SE3_ego).max() if matrices.shape == clip.start_SE3_ego.shape else np.inf
    if not apart <= _AGREE_M:
        raise DatasetError(
            f"poses of {len(matrices)} frames that differ by {apart:.2g}",
            place=clip.clip_id,
            expected=f"those of its {len(clip)} frames",
        )
