"""From a window of a traversal to a clip: recorded images, rendered backgrounds, masks, boxes and cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.clips.map_lines import MapLine, crop_lines, move_lines
from hybridworldsim.generation.recorded.hidden import HiddenShares
from hybridworldsim.generation.recorded.road_users import FramePixels, boxes_at, read_pixels
from hybridworldsim.generation.scenes.backgrounds import Background
from hybridworldsim.generation.scenes.rig import SceneRig
from hybridworldsim.generation.scenes.scene_clip import PlannedFrame, boxes_of, scale_background
from mirror.arrays import Bool, UInt8
from mirror.dataset.frames import Frame
from mirror.geometry.poses import Poses


@dataclass(frozen=True, eq=False)
class RecordedFrame:
    """A recorded frame in the generator's raster.

    Attributes:
        images: (V, H, W, 3).
        street: (V, H, W) pixels inside the lens and not on the recording vehicle.
        pixels: what the pixels show.
    """

    images: UInt8
    street: Bool
    pixels: FramePixels


@dataclass(frozen=True, eq=False)
class WindowSource:
    """The source of the clips of a traversal.

    Attributes:
        rig: the cameras, in the model's calibrations.
        background: images of the street without road users.
        rate_hz: frames per second.
        light: light of the traversal.
        weather: weather of the traversal.
        tracks: numbers of road users by track id.
        min_score: boxes with a lower score are left out.
        lines: lines of the scene's map in the world; None: there is none.
        hidden: gives the shares of training images that hide a place; None: they are not known.
    """

    rig: SceneRig
    background: Background
    rate_hz: float
    light: str
    weather: str
    tracks: Mapping[str, int]
    min_score: float
    lines: tuple[MapLine, ...] | None = None
    hidden: HiddenShares | None = None

    def read(self, frame: Frame) -> RecordedFrame:
        """Read the images and masks of a frame.

        Raises:
            DatasetError: an image or a mask is missing or broken.
        """
        images, street = self.rig.images(frame)
        return RecordedFrame(images, street, read_pixels(frame, self.rig, street, self.tracks, self.min_score))

    def make_clip(self, clip_id: str, frames: Sequence[Frame], recorded: Sequence[RecordedFrame]) -> Clip:
        """Make the clip of consecutive frames.

        Each background is rendered from where its camera was at its own mid-exposure. Pixels outside the lens and on
        the recording vehicle are those of the background.

        Args:
            clip_id: id of the clip.
            frames: F frames.
            recorded: what `read` returned for them.

        Raises:
            DatasetError: a background has another size than its view, or a box is not finite.
        """
        rig = self.rig
        egos = [frame.world_SE3_ego for frame in frames]
        background = np.zeros((len(frames), len(rig.cameras), *rig.size_px, 3), np.uint8)
        hidden = np.zeros(background.shape[:-1], np.uint8)
        cameras = np.zeros((*background.shape[:2], 4, 4))
        for place, (frame, ego) in enumerate(zip(frames, egos)):
            for row, view in enumerate(rig.views(frame, ego, self.light, self.weather)):
                world_SE3_camera = view.pose
                if view.camera in frame.images:
                    image = frame.images[view.camera]
                    world_SE3_camera = image.world_SE3_camera
                    moved = {"world_SE3_camera": world_SE3_camera, "timestamp_ns": image.timestamp_ns}
                    view = view.model_copy(update=moved)
                cameras[place, row] = (ego.inverse() @ world_SE3_camera).matrix()[0]
                shape = view.height_px, view.width_px
                background[place, row] = scale_background(self.background(view), shape, rig.size_px)
                if self.hidden is not None:
                    hidden[place, row] = self.hidden.of_view(view, rig.size_px)
        excluded = np.stack([one.pixels.excluded for one in recorded])
        street = np.stack([one.street for one in recorded])
        start = egos[0].inverse()
        places_m = np.concatenate([one.translation for one in egos])
        planned = [PlannedFrame(frame, ego) for frame, ego in zip(frames, egos)]
        return Clip(
            clip_id,
            frames[0].traversal_id,
            self.rate_hz,
            rig.cameras,
            np.where(street[..., None], np.stack([one.images for one in recorded]), background),
            background,
            np.array([[camera in frame.images for camera in rig.cameras] for frame in frames]),
            rig.intrinsics,
            rig.ego_SE3_camera.matrix(),
            _chain(start, egos).matrix(),
            boxes_of(planned, self.tracks, lambda frame: boxes_at(frame, self.min_score)),
            np.stack([one.pixels.tracks for one in recorded]),
            None if self.lines is None else move_lines(crop_lines(self.lines, places_m), start.matrix()[0]),
            cameras,
            excluded,
            None if self.hidden is None else hidden,
        )


def _chain(start: Poses, egos: Sequence[Poses]) -> Poses:
    """The poses of the vehicle in its first frame."""
    rotation = np.concatenate([one.rotation for one in egos])
    return start @ Poses.unchecked(rotation, np.concatenate([one.translation for one in egos]))
