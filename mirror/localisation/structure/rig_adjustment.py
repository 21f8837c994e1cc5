"""A joint bundle adjustment of a rig: the mapped camera and all others that see points of its map, by pycolmap.

Each mapped image is a frame with the images of other cameras near it in time. Their places relative to the mapped one
are constant: the recorded mountings, with the errors of their rotations that `scale_from_rig` finds, and the vehicle's
motion between the exposures. Distances on the vehicle are metres, so the whole map has metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.geometry import Poses, matrix_from_quaternion, quaternion_from_matrix
from mirror.geometry.cameras import Camera
from mirror.localisation.structure.maps import ImageMap, ideal_camera, to_pycolmap
from mirror.localisation.structure.used_images import UsedImages

_LEAST_SEEN: Final = 8
"""Fewer points hold no camera; wrong matches are a larger share among them."""


@dataclass(frozen=True, eq=False)
class SeenByOther:
    """Points of a map in one image of another camera.

    Attributes:
        frame: row of the mapped image that is nearest in time.
        frame_SE3_other: from the other camera at its exposure to the mapped camera at its own, metres; one pose.
        lens: lens of the other camera.
        uv_px: (K, 2) positions in the ideal camera of that lens.
        points: (K,) rows of the points.
    """

    frame: int
    frame_SE3_other: Poses
    lens: Camera
    uv_px: Float64
    points: Int64


def adjust_rig(images: UsedImages, found: ImageMap, scale: float, seen: Sequence[SeenByOther]) -> ImageMap:
    """Adjust the poses and points of a map together with the images of the other cameras.

    Args:
        images: the used images of the mapped camera.
        found: its map.
        scale: metres per unit.
        seen: the images of the other cameras.

    Returns:
        The map in metres; its ``reconstruction`` is the one that was given.
    """
    import pycolmap

    kept = [one for one in seen if len(one.points) >= _LEAST_SEEN]
    if not kept:
        # Nothing holds the scale: the map stays as it is.
        poses = Poses(found.world_SE3_camera.rotation, scale * found.world_SE3_camera.translation)
        return replace(found, world_SE3_camera=poses, points=scale * found.points)
    builder = _Builder(images, found, scale)
    for one in kept:
        builder.add_other(one)
    rig = builder.build()
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_focal_length = options.refine_principal_point = options.refine_extra_params = False
    options.refine_sensor_from_rig = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in rig.images:
        config.add_image(image_id)
    # The first frame holds the map in place; the distances of the cameras hold its scale.
    config.set_constant_rig_from_world_pose(1)
    pycolmap.create_default_bundle_adjuster(options, config, rig).solve()
    back = [rig.frames[row + 1].rig_from_world.inverse() for row in range(len(found.used))]
    turns = np.array([one.rotation.matrix() for one in back])
    poses = Poses(quaternion_from_matrix(turns), np.array([one.translation for one in back]))
    points = found.points * scale
    for row, number in builder.number_of_point.items():
        points[row] = rig.points3D[number].xyz
    return replace(found, world_SE3_camera=poses, points=points)


class _Builder:
    """Makes a reconstruction with a rig of its own for each frame."""

    def __init__(self, images: UsedImages, found: ImageMap, scale: float) -> None:
        self._images, self._found, self._scale = images, found, scale
        self._others: list[list[SeenByOther]] = [[] for _ in found.used]
        self.number_of_point: dict[int, int] = {}

    def add_other(self, seen: SeenByOther) -> None:
        """Add an image of another camera."""
        self._others[seen.frame].append(seen)

    def build(self) -> Any:
        """Make the reconstruction."""
        import pycolmap

        made = pycolmap.Reconstruction()
        tracks: dict[int, list[tuple[int, int]]] = {}
        for frame_number, others in enumerate(self._others, 1):
            row = frame_number - 1
            pose = self._found.world_SE3_camera[row : row + 1]
            own = self._own_points(row)
            parts = [(self._found.lens, *own, None), *((one.lens, one.uv_px, one.points, one) for one in others)]
            rig, frame, images = pycolmap.Rig(rig_id=frame_number), pycolmap.Frame(), []
            frame.frame_id, frame.rig_id = frame_number, frame_number
            for lens, uv, points, other in parts:
                number = made.num_cameras() + 1
                camera = to_pycolmap(lens, (lens.width_px, lens.height_px))
                camera.camera_id = number
                made.add_camera(camera)
                if other is None:
                    rig.add_ref_sensor(camera.sensor_id)
                else:
                    rig.add_sensor(camera.sensor_id, _to_rigid(other.frame_SE3_other.inverse()))
                image = pycolmap.Image(f"{number:08d}", uv, number, number)
                image.frame_id = frame_number
                frame.add_data_id(image.data_id)
                images.append(image)
                for place, point in enumerate(points.tolist()):
                    tracks.setdefault(point, []).append((number, place))
            made.add_rig(rig)
            placed = Poses(pose.rotation, pose.translation * self._scale).inverse()
            frame.rig_from_world = _to_rigid(placed)
            made.add_frame(frame)
            for image in images:
                made.add_image(image)
            made.register_frame(frame_number)
        for point, shown in tracks.items():
            if len(shown) < 2:
                # One ray places no point.
                continue
            track = pycolmap.Track()
            for image_id, place in shown:
                track.add_element(image_id, place)
            self.number_of_point[point] = made.add_point3D(self._found.points[point] * self._scale, track)
        return made

    def _own_points(self, row: int) -> tuple[Float64, Int64]:
        """The points of a mapped image and where they lie in it, as the map has them."""
        points, shown = self._found.observed[row]
        rays = self._found.lens.unproject(self._images.features[self._found.used[row]].uv_px[shown]).direction
        return ideal_camera(self._found.lens).project(rays).uv_px, points


def _to_rigid(pose: Poses) -> Any:
    import pycolmap

    turn = matrix_from_quaternion(pose.rotation)[0]
    return pycolmap.Rigid3d(pycolmap.Rotation3d(turn), pose.translation[0])
