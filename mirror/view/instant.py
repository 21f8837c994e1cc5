"""One instant on a page: the boxes and the cameras' fields of view from above, and the cameras over the time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from mirror.arrays import Float64
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.pages.images import inline_image
from mirror.pages.rendering import render_part
from mirror.view.images import category_colours, rig_images

if TYPE_CHECKING:
    from markupsafe import Markup

REACH_M: Final = 45.0
"""Half the side of the drawing from above."""
_CONE_M: Final = 14.0
_RIM_POINTS: Final = 9
_RINGS_M: Final = (10, 20, 30, 40)
_EGO_M: Final = (-1.0, 3.8, 0.95)
_TIMES: Final = 8
_THUMB_PX: Final = 128


def draw_from_above(frame: Frame, *, boxes: bool) -> Markup:
    """Draw an instant from above as SVG, with the heading upwards: cameras with their fields of view, and boxes.

    Args:
        frame: the frame.
        boxes: whether to draw its boxes.
    """
    cones = []
    for camera, image in frame.images.items():
        outline = trace_cone(frame, image)
        cones.append({"camera": camera, "points": _points(outline), "label": _place(outline[len(outline) // 2])})
    drawn = []
    if boxes:
        found = frame.boxes()
        colours = category_colours(found.category)
        for row in range(len(found)):
            length, width = found.size_m[row, :2]
            corners = np.array([(length, width, 0), (length, -width, 0), (-length, -width, 0), (-length, width, 0)]) / 2
            outline = found.pose[row : row + 1].transform(corners)[0, :, :2]
            if np.abs(outline).min(axis=0).max() < REACH_M:
                category = found.category[row]
                nose = 0.5 * (outline[0] + outline[1])
                heading = _points(np.stack([outline.mean(axis=0), nose]))
                drawn.append(
                    {
                        "points": _points(outline),
                        "heading": heading,
                        "category": category,
                        "colour": colours[category],
                    }
                )
    rear, front, half = _EGO_M
    ego = np.array([(front, half), (front, -half), (rear, -half), (rear, half)])
    rings = [(f"{radius}", f"{-radius + 1.6:.1f}") for radius in _RINGS_M]
    return render_part("mirror.view", "instant.html", "from_above", REACH_M, rings, cones, drawn, _points(ego))


def trace_cone(frame: Frame, image: Image) -> Float64:
    """Trace the field of view of a camera from above, in the ego frame at the frame's time.

    Returns:
        (P, 2) metres: the place of the camera, then points of an arc between the rays of the middle row's ends.
    """
    lens = image.camera_model
    ego_SE3_camera = frame.world_SE3_ego.inverse() @ image.world_SE3_camera
    u = np.linspace(0.5, lens.width_px - 0.5, _RIM_POINTS)
    rays = lens.unproject(np.column_stack([u, np.full_like(u, 0.5 * lens.height_px)])).direction
    rays = rays[np.isfinite(rays).all(axis=1)]
    middle = ego_SE3_camera.translation[0]
    ahead = ego_SE3_camera.transform(rays)[0] - middle
    flat = ahead[:, :2] / np.maximum(np.linalg.norm(ahead[:, :2], axis=1, keepdims=True), 1e-9)
    return np.concatenate([middle[None, :2], middle[:2] + _CONE_M * flat])


def cameras_over_time(dataset: Dataset, traversal_id: str, *, width_px: int) -> Markup | None:
    """Format a strip of each camera over a traversal, and the images of one instant, which a choice in it changes.

    Args:
        dataset: the dataset.
        traversal_id: the traversal.
        width_px: maximum width of the images of an instant.

    Returns:
        The part of the page; None: the traversal has one frame only.
    """
    frames = dataset.where(traversal=traversal_id).frames()
    if len(frames) < 2:
        return None
    places = np.unique(np.linspace(0, len(frames) - 1, _TIMES).round().astype(int))
    chosen = [frames[int(place)] for place in places]
    cameras = list(dict.fromkeys(camera for frame in chosen for camera in frame.images))
    start_ns = frames[0].timestamp_ns
    instants = [
        {
            "time": f"{1e-9 * (frame.timestamp_ns - start_ns):.1f} s",
            "thumbs": [
                inline_image(frame.images[camera].decode(), camera, _THUMB_PX) if camera in frame.images else None
                for camera in cameras
            ],
            "images": rig_images(frame, boxes=False, width_px=width_px),
        }
        for frame in chosen
    ]
    return render_part("mirror.view", "instant.html", "over_time", instants, cameras, len(instants))


def _points(outline: Float64) -> str:
    """Format points of the ego frame for a drawing whose x points right and whose y points down."""
    return " ".join(_place(point) for point in outline)


def _place(point: Sequence[float] | Float64) -> str:
    return f"{-point[1]:.2f},{-point[0]:.2f}"
