"""The exact truth of views of the synthetic street: depth, labels, and the image in another light."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from mirror.arrays import Bool, Float32, Float64, UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError
from mirror.geometry.cameras import Camera
from mirror.metrics.images.psnr import psnr
from mirror.protocols.truth.raster import cached_raster
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView
from mirror.synth.model import NO_OBJECT

if TYPE_CHECKING:
    from mirror.synth.fleet.drive import SynthDrive
    from mirror.synth.render.scene import Scene
    from mirror.synth.writing.schedule import ImageSchedule

_LEAST_DB: Final = 28.0
"""A recorded image and its second rendering differ by noise and JPEG loss; another street has about 20 dB."""
_GROUND_M: Final = 500.0
"""The ground of a scene reaches further than this from its middle, along either axis."""


@dataclass(frozen=True, eq=False)
class TrueView:
    """Exact truth of a view's pixels.

    Attributes:
        depth_m: (H, W) float32 camera z at the pixels' centres; infinite in the sky.
        label: (H, W) values of `mirror.synth.model.Label`.
        static: (H, W) whether it is the street: neither sky nor a road user.
    """

    depth_m: Float32
    label: UInt8
    static: Bool


def camera_z(distance_m: npt.ArrayLike, lens: Camera) -> Float64:
    """Convert distances (H, W) along the rays of a lens's pixel centres to camera z; infinite stays so."""
    direction = lens.rays().direction
    z: Float64 = np.asarray(distance_m, np.float64) * direction[..., 2] / np.linalg.norm(direction, axis=-1)
    return z


def world_points(depth_m: npt.ArrayLike, view: RenderView) -> Float64:
    """Return the world points (H, W, 3) that pixels with camera z (H, W) show."""
    direction = view.lens.rays().direction
    local = np.asarray(depth_m, np.float64)[..., None] * direction / direction[..., 2:]
    points: Float64 = local @ view.pose.matrix()[0, :3, :3].T + view.pose.translation[0]
    return points


class StreetTruth:
    """The synthetic street that a dataset's recordings are of.

    Args:
        dataset: dataset of recordings that ``mirror synth`` wrote.
        plan: plan of the requested views.
        preset: preset of the recordings.
        seed: seed of the recordings.

    Attributes:
        recorded: the recorded images, and which of their pixels are scored.
    """

    def __init__(self, dataset: Dataset, plan: Plan, preset: str, seed: int) -> None:
        rows = dataset.table("traversals", ["traversal_id", "drive_id"]).to_pylist()
        self._drive_ids = {row["traversal_id"]: row["drive_id"] for row in rows}
        self.recorded = GroundTruth(dataset, plan.protocol, plan.layers)
        self._pixels, self._preset, self._seed = plan.protocol.pixels, preset, seed
        self._checked: set[str] = set()
        self._views: dict[str, TrueView] = {}
        self._relit: dict[tuple[str, str, bool], UInt8] = {}

    def true_view(self, view: RenderView) -> TrueView:
        """Return the depth and labels from the pose and lens of a view; kept for the next model.

        Raises:
            DatasetError: the recordings are of another street.
        """
        if view.path not in self._views:
            self._views[view.path] = self._trace(view)
        return self._views[view.path]

    def relit(self, view: RenderView, traversal_id: str, *, as_recorded: bool = False) -> UInt8:
        """Return the view's image (H, W, 3), RGB, with the light, weather, leaves and camera response of a traversal.

        Lens, road users and headlights are those of the view's own traversal. The image is rendered and resampled as
        recorded images are, and kept.

        Args:
            view: pose, lens and moment.
            traversal_id: of the light.
            as_recorded: use the recorded pose, which is all that a method knows, in place of the true one.

        Raises:
            DatasetError: the recordings are of another street.
        """
        key = (view.path, traversal_id, as_recorded)
        if key not in self._relit:
            self._require(view)
            self._relit[key] = self._render_relit(view, traversal_id, as_recorded=as_recorded)
        return self._relit[key]

    def height_m(self, view: RenderView, points_m: Float64) -> Float64:
        """Return the heights (...,) of the ground under or above points (..., 3) of a view's scene."""
        x, y = (np.clip(points_m[..., axis], -_GROUND_M, _GROUND_M) for axis in (0, 1))
        return self._drive(view.traversal_id).drive.world.height_m(x, y)

    def _trace(self, view: RenderView) -> TrueView:
        from mirror.synth.render.lens import make_lens
        from mirror.synth.render.view import rasterize_view

        self._require(view)
        drive, moment = self._drive(view.traversal_id), self._moment(view)
        pose = view.pose
        instant = drive.drive.stage.around(moment.seconds, pose.translation[0])
        seen = rasterize_view(instant.surroundings, make_lens(view.lens), pose.matrix()[0, :3, :3], pose.translation[0])
        depth = camera_z(seen.distance_m, view.lens).astype(np.float32)
        return TrueView(depth, seen.label, np.isfinite(depth) & (seen.object == NO_OBJECT))

    def _require(self, view: RenderView) -> None:
        """Check that the first view of each traversal, rendered again, equals the recorded image."""
        if view.traversal_id in self._checked:
            return
        alike = float(psnr(self._render_relit(view, view.traversal_id), self.recorded.image(view)))
        if alike < _LEAST_DB:
            raise DatasetError(
                f"preset {self._preset}, seed {self._seed}, is not the recorded street ({alike:.1f} dB)",
                place=view.path,
                expected=f"{_LEAST_DB:g} dB or more between a recorded image and its second rendering",
                remedy="make the recordings again",
            )
        self._checked.add(view.traversal_id)

    def _render_relit(self, view: RenderView, traversal_id: str, *, as_recorded: bool = False) -> UInt8:
        own, other, moment = self._drive(view.traversal_id), self._drive(traversal_id), self._moment(view)
        stage = own.stage_lit_by(other)
        stamps = np.array([moment.true_ns])
        drive = own.drive
        rendering = stage.render(
            stage.at(moment.seconds, drive.world_SE3_ego(stamps)),
            drive.lenses[view.camera],
            view.pose if as_recorded else drive.world_SE3_camera(view.camera, stamps),
            response=other.drive.camera_responses[view.camera],
            seed=moment.true_ns % (1 << 31),
        )
        _, image = self.recorded.recorded_frame_and_image(view)
        raster = cached_raster(image.camera_model, self._pixels)
        return raster.to_final(np.ascontiguousarray(rendering.bgr[..., ::-1]))

    def _moment(self, view: RenderView) -> _Moment:
        drive = self._drive(view.traversal_id)
        at = np.flatnonzero(drive.schedule.recorded_ns[view.camera] == view.timestamp_ns)
        if not len(at):
            raise DatasetError(
                f"preset {self._preset}, seed {self._seed}, has no image at {view.timestamp_ns}", place=view.path
            )
        true_ns = int(drive.schedule.true_ns[view.camera][at[0]])
        return _Moment(true_ns, float(drive.drive.seconds(np.array([true_ns]))[0]))

    @cache  # noqa: B019 - as many as the dataset has traversals
    def _drive(self, traversal_id: str) -> _Drive:
        from mirror.synth.fleet.drives import make_drive

        return _Drive(make_drive(self._preset, self._seed, self._drive_ids[traversal_id]))


@dataclass(frozen=True)
class _Moment:
    true_ns: int
    seconds: float


@dataclass(frozen=True, eq=False)
class _Drive:
    drive: SynthDrive

    @cached_property
    def schedule(self) -> ImageSchedule:
        from mirror.synth.writing.schedule import schedule_images

        return schedule_images(self.drive, self.drive.preset.errors)

    @cache  # noqa: B019 - as many as the dataset has traversals
    def stage_lit_by(self, other: _Drive) -> Scene:
        """The stage of this drive in the light of another drive."""
        from mirror.synth.render.scene import Scene

        if other is self:
            return self.drive.stage
        own = self.drive
        return Scene(own.world, other.drive.condition, own.road_users, own.ego_model, clock_s=own.truth.clock_s)
