"""The layout images of a frame: those of all its views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybridworldsim.generation.clips.clip import Clip, ClipBoxes
from hybridworldsim.generation.clips.map_lines import MapLine
from hybridworldsim.generation.layout.boxes import BoxStyle, draw_boxes
from hybridworldsim.generation.layout.map_lines import MAP_CHANNELS, draw_map
from hybridworldsim.generation.network.configuration import TransformerConfig
from mirror.arrays import Float32, Float64


def draw_layout(
    boxes: ClipBoxes,
    intrinsics: Float64,
    ego_SE3_camera: Float64,
    size_px: tuple[int, int],
    style: BoxStyle,
    *,
    lines: Sequence[MapLine] | None = None,
    ego_SE3_line: Float64 | None = None,
) -> Float32:
    """Draw the boxes of one frame into all views, and the lines of a map.

    Args:
        boxes: boxes of one frame.
        intrinsics: (V, 3, 3), pixels.
        ego_SE3_camera: (V, 4, 4).
        size_px: height and width of the images.
        style: what is drawn of a box.
        lines: lines of the map; None: no channels for a map.
        ego_SE3_line: (4, 4) pose of the frame of the lines; None: they are in the ego frame.

    Returns:
        (V, channels, height, width) from 0 to 1; the map's three channels are the last ones.

    Raises:
        UsageError: a box or a line is not finite.
    """
    views = []
    for lens, mount in zip(intrinsics, ego_SE3_camera):
        camera_SE3_ego = np.linalg.inv(mount)
        image = draw_boxes(camera_SE3_ego @ boxes.ego_SE3_box, boxes.lwh_m, boxes.category, lens, size_px, style)
        if lines is not None:
            pose = np.eye(4) if ego_SE3_line is None else ego_SE3_line
            of_map = draw_map(lines, pose, camera_SE3_ego, lens, size_px, style.width_px)
            image = np.concatenate([image, of_map])
        views.append(image)
    return np.stack(views)


def takes_map(config: TransformerConfig, style: BoxStyle) -> bool:
    """Return whether a network takes a map: its layout then has three channels per frame besides the boxes'."""
    channels = config.layout_frames * (style.channels + MAP_CHANNELS)
    return config.layout is not None and config.layout.channels == channels


def draw_frame_layout(clip: Clip, frame: int, style: BoxStyle, config: TransformerConfig) -> Float32:
    """Return the layout of one frame of a clip, in the form that a network takes.

    Args:
        clip: the clip.
        frame: number of the frame.
        style: what is drawn of a box.
        config: the network.

    Returns:
        (V, channels, height, width); where the network takes a map and the clip has none, its channels have the
        style's value of what is not known.
    """
    shown = takes_map(config, style)
    layout = draw_layout(
        clip.boxes.at(frame), clip.intrinsics, clip.cameras_at(frame), clip.size_px, style,
        lines=clip.lines if shown else None, ego_SE3_line=np.linalg.inv(clip.start_SE3_ego[frame]),
    )  # fmt: skip
    if not shown or clip.lines is not None:
        return layout
    unknown = np.full((len(layout), MAP_CHANNELS, *clip.size_px), style.dropped, np.float32)
    return np.concatenate([layout, unknown], axis=1)


def draw_clip_layout(clip: Clip, style: BoxStyle, config: TransformerConfig) -> Float32:
    """Return the layout of all frames of a clip, as a network takes it: (F, V, channels, height, width)."""
    return np.stack([draw_frame_layout(clip, frame, style, config) for frame in range(len(clip))])
