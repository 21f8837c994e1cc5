"""The options of an initialisation."""

from __future__ import annotations

from dataclasses import dataclass

from hybridworldsim.stationary import STATIONARY_M
from mirror.protocols.document import Pixels


@dataclass(frozen=True)
class InitialisationOptions:
    """The options of an initialisation. Field names are part of the hash that layers store.

    Attributes:
        width_px: greatest width of the rasters in which images are matched.
        standing_m: an image is left out if its camera moved less than this since the last image that was kept.
        sources: number of images that each image is matched with.
        held_against: number of depth maps that each depth map is compared with.
        near_m: smallest depth searched.
        far_m: largest depth searched.
        least_confidence: a depth with less confidence is unknown; None: the default of the method.
        agree_share: two depths agree if they differ by at most this share, and the point reprojects within a pixel.
        depth_views: a depth is written if at least this number of images agree, its own image included.
        point_views: a depth becomes a point if at least this number of images agree.
        voxel_m: side of the cells that keep one point each.
        far_from_m: points farther than this from all driven positions are of kind ``far``.
        sky: whether the initialisation makes masks of the sky.
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
