"""How a reconstruction is initialised."""

from __future__ import annotations

from dataclasses import dataclass

from hybridworldsim.stationary import STATIONARY_M
from mirror.protocols.document import Pixels


@dataclass(frozen=True)
class InitialisationOptions:
    """How a reconstruction is initialised.

    Attributes:
        width_px: widest raster of the pictures that are matched.
        standing_m: a picture is not matched whose camera is nearer than this to the last of its own.
        sources: pictures that each picture is matched with.
        held_against: pictures that each depth map is held against.
        near_m: smallest depth searched.
        far_m: largest depth searched.
        least_confidence: an estimate below it is unknown; None: what the method's own authors use, or like it.
        agree_share: depths agree that differ by at most this share of them, and whose points land within a pixel.
        depth_views: a depth is written if so many pictures agree on it, its own included.
        point_views: a point is made of it if so many agree.
        voxel_m: side of the cells that hold one point each.
        far_from_m: points farther than this from all driven lines are of kind ``far``.
        sky: whether masks of the sky are made.
    """

    width_px: int = 240
    standing_m: float = STATIONARY_M
    sources: int = 4
    held_against: int = 8
    near_m: float = 2.0
    far_m: float = 200.0
    least_confidence: float | None = None
    agree_share: float = 0.02
    depth_views: int = 3
    point_views: int = 4
    voxel_m: float = 0.1
    far_from_m: float = 60.0
    sky: bool = True

    @property
    def pixels(self) -> Pixels:
        """The raster of the depth maps."""
        return Pixels(space="undistorted", max_width_px=self.width_px)
