"""Shares of training images in which a road user hides a place of the street: there a static model learned little."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch

from hybridworldsim.generation.recorded.road_users import masked_pixels
from hybridworldsim.generation.recorded.windows import MASK_KINDS
from hybridworldsim.generation.scenes.rig import SceneRig
from hybridworldsim.kept_items import KeptItems
from mirror.arrays import AnyArray, Bool, Float64, Int64, UInt8
from mirror.dataset.frames import FrameSequence
from mirror.geometry.cameras import Camera
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses
from mirror.methods.depth_renderers import DepthRendering
from mirror.protocols.views.view import RenderView

CELL_PX: Final = 4
"""Side of the square of pixels that gets one share."""
_APART_M: Final = 6.0
_NEAR_M: Final = 40.0
_MOST_FRAMES: Final = 8
_MOST_TRAVERSALS: Final = 12
_SOLID: Final = 0.5
"""Least share of a pixel that the model covers; what lies behind less is sky, which no road user hides for long."""
_KEPT_BYTES: Final = 256 << 20


@dataclass(frozen=True, eq=False)
class _Look:
    """One training image: its lens in the generator's raster, its pose, and its pixels of road users and of no use."""

    lens: Camera
    camera_SE3_world: Poses
    masked: Bool
    useless: Bool


@dataclass(frozen=True, eq=False)
class _Drive:
    frames: FrameSequence
    rig: SceneRig
    anchors: Int64
    places_m: Float64


class HiddenShares:
    """Shares of training images in which a mask of road users hides a place.

    Of each training traversal, frames every 6 m are looked at, the 8 nearest within 40 m. What stands before a place
    is not known otherwise: an image in which a wall hides it counts as one that sees it.

    Args:
        drives: frames and cameras of the training traversals; of more than 12, as many evenly chosen ones are used.
        render: renders a view of the static model with its depth.
    """

    def __init__(
        self, drives: Sequence[tuple[FrameSequence, SceneRig]], render: Callable[[RenderView], DepthRendering]
    ) -> None:
        count = min(len(drives), _MOST_TRAVERSALS)
        chosen = np.unique(np.linspace(0, len(drives) - 1, count).round().astype(int)).tolist()
        self._drives = [_drive(*drives[number]) for number in chosen]
        self._render = render
        self._looks: KeptItems[tuple[int, int], list[_Look]] = KeptItems(_KEPT_BYTES)

    def of_view(self, view: RenderView, size_px: tuple[int, int]) -> UInt8:
        """Return the hidden share (H, W) at each pixel of a view, in 255ths; 0 where no training image sees the place.

        Args:
            view: the view, with a lens of any raster.
            size_px: height and width of the result.
        """
        height, width = (max(side // CELL_PX, 1) for side in size_px)
        lens = view.lens.resized(width, height)
        rendered = self._render(view.model_copy(update=lens.to_row()))
        depth_m, alpha = (
            torch.as_tensor(one).detach().cpu().double().numpy() for one in (rendered.depth_m, rendered.alpha)
        )
        u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        rays = lens.unproject(np.stack([u, v], axis=-1)).direction
        solid = (alpha >= _SOLID) & (depth_m > 0.0) & np.isfinite(depth_m)
        points_m = rays[solid] / rays[solid][:, 2:] * depth_m[solid][:, None]
        shares = np.zeros((height, width))
        shares[solid] = self.of_points(view.pose.transform(points_m)[0], view.pose.translation[0])
        rows, columns = (
            np.minimum(np.arange(side) // CELL_PX, cells - 1) for side, cells in zip(size_px, (height, width))
        )
        return np.round(shares * 255.0).astype(np.uint8)[rows][:, columns]

    def of_points(self, points_m: Float64, place_m: Float64) -> Float64:
        """Return the share (N,) of the images that see a point in which a road user hides it; 0 where none sees it.

        Args:
            points_m: (N, 3) points in the world.
            place_m: (3,) place from which they are seen; training images near it are used.
        """
        looked, hidden = np.zeros(len(points_m)), np.zeros(len(points_m))
        for number, drive in enumerate(self._drives):
            away = np.linalg.norm(drive.places_m - place_m, axis=1)
            nearest = np.argsort(away, kind="stable")[:_MOST_FRAMES]
            for anchor in drive.anchors[nearest[away[nearest] <= _NEAR_M]].tolist():
                for look in self._looks_of(number, anchor):
                    projected = look.lens.project(look.camera_SE3_world.transform(points_m)[0])
                    seen = np.flatnonzero(projected.valid)
                    columns, rows = projected.uv_px[seen].astype(np.int64).T
                    useful = ~look.useless[rows, columns]
                    looked[seen[useful]] += 1.0
                    hidden[seen[useful & look.masked[rows, columns]]] += 1.0
        return hidden / np.maximum(looked, 1.0)

    def _looks_of(self, number: int, anchor: int) -> list[_Look]:
        return self._looks.get((number, anchor), lambda: _look(self._drives[number], anchor), _bytes)


def _bytes(looks: list[_Look]) -> int:
    return sum(one.masked.nbytes + one.useless.nbytes for one in looks)


def _drive(frames: FrameSequence, rig: SceneRig) -> _Drive:
    stamps = np.array([frame.timestamp_ns for frame in frames], np.int64)
    places_m = interpolate(*frames[0].track, stamps).translation
    driven_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places_m, axis=0), axis=1))])
    # The first frame in each stretch of so many metres: a standing vehicle counts once.
    _, anchors = np.unique(driven_m // _APART_M, return_index=True)
    return _Drive(frames, rig, anchors, places_m[anchors])


def _look(drive: _Drive, anchor: int) -> list[_Look]:
    frame, looks = drive.frames[anchor], []
    for row, camera in enumerate(drive.rig.cameras):
        if camera in frame.images:
            image, raster = frame.images[camera], drive.rig.rasters[row]
            useless: AnyArray = ~raster.covered
            ego = image.static_mask()
            if ego is not None:
                useless = useless | (raster.mask(ego) > 0)
            masked = masked_pixels(image, raster, MASK_KINDS)
            looks.append(_Look(drive.rig.raster_lens(row), image.world_SE3_camera.inverse(), masked, useless))
    return looks
