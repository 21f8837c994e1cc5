"""Compares the truth of views with each other: seven cameras, several traversals, boxes and masks."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from mirror.geometry import Poses, matrix_from_quaternion, project_boxes, quaternion_from_matrix
from mirror.schema.documents import CANONICAL_CAMERAS
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.fleet.drives import make_drives
from mirror.synth.model import Label, Material, Model
from mirror.synth.render.scene import Instant
from mirror.synth.render.view import RasterizedView, rasterize_view
from mirror.synth.truth.casting import cast_rays

MOMENTS = (0.35, 0.6)


@cache
def drives() -> list[SynthDrive]:
    """Two traversals of one scene, by different vehicles in different light."""
    _, found = make_drives("tiny", 0)
    return [drive for drive in found if drive.recipe.images][:2]


@dataclass(frozen=True)
class SeenView:
    drive: SynthDrive
    camera: str
    instant: Instant
    world_SE3_camera: Poses
    view: RasterizedView

    @property
    def rotation(self) -> np.ndarray:
        return matrix_from_quaternion(self.world_SE3_camera.rotation)[0]

    @property
    def origin(self) -> np.ndarray:
        return self.world_SE3_camera.translation[0]


@cache
def views(number: int, moment: float) -> list[SeenView]:
    drive = drives()[number]
    drive.prepare()
    stamp = drive.condition.start_ns + int(moment * drive.truth.duration_s * 1e9)
    instant = drive.at(stamp)
    found = []
    for camera in CANONICAL_CAMERAS:
        pose = drive.world_SE3_camera(camera, np.array([stamp]))
        view = rasterize_view(
            instant.surroundings, drive.lenses[camera], matrix_from_quaternion(pose.rotation)[0], pose.translation[0]
        )
        found.append(SeenView(drive, camera, instant, pose, view))
    return found


def everything() -> Iterator[SeenView]:
    for number in range(2):
        for moment in MOMENTS:
            yield from views(number, moment)


def static_points(seen: SeenView, rng: np.random.Generator, count: int) -> np.ndarray:
    """World points of static rigid surfaces through pixel centres."""
    view = seen.view
    label = view.label
    own = np.concatenate([view.scene.faces["material"], view.scene.rounds["material"], [Material.LEAVES]])
    steady = (label != Label.SKY) & (label != Label.EGO) & (view.object < 0) & (own[view.surface] != Material.LEAVES)
    picked = rng.permutation(np.flatnonzero(steady.ravel()))[:count]
    rays = view.lens.rays.reshape(-1, 3)[picked] @ seen.rotation.T
    return seen.origin + view.distance_m.ravel()[picked, None] * rays


def static_model(drive: SynthDrive) -> Model:
    """The world without the parts that change between traversals."""
    model = drive.world.model
    return Model(model.faces[model.faces["material"] != Material.LEAVES], model.corners, model.rounds[:0])


def test_points_of_one_view_reproject_into_the_others() -> None:
    rng = np.random.default_rng(1)
    model = static_model(drives()[0])
    checked = visible = 0
    for seen in everything():
        points = static_points(seen, rng, 40)
        for other in rng.permutation(np.array(list(everything()), object))[:3]:
            away = points - other.origin
            far = np.linalg.norm(away, axis=1)
            distance, _ = cast_rays(model, other.origin, away / far[:, None])
            # The point may be hidden by a nearer surface, but must not be behind an opening.
            assert (distance <= far + 1e-3).all()
            checked += len(points)
            visible += int((np.abs(distance - far) < 1e-3).sum())
    assert checked > 2500
    assert visible > 0.1 * checked


def test_a_projected_point_lies_on_the_surface_of_its_pixel() -> None:
    rng = np.random.default_rng(2)
    met = through = 0
    for number in range(2):
        for seen in views(number, MOMENTS[0]):
            points = static_points(seen, rng, 400)
            for other in [*views(0, MOMENTS[0]), *views(0, MOMENTS[1]), *views(1, MOMENTS[1])]:
                view = other.view
                camera = other.drive.vehicle.cameras[other.camera]
                local = (points - other.origin) @ other.rotation
                image = camera.project(local)
                inside = image.valid
                pixel = np.floor(np.where(inside[:, None], image.uv_px, 0)).astype(int)
                for point, (column, row) in zip(points[inside], pixel[inside]):
                    if view.mixed[row, column] or view.surface[row, column] >= len(view.scene.faces):
                        continue
                    face = view.scene.faces[view.surface[row, column]]
                    if face["object"] >= 0 or face["label"] == Label.SKY or face["material"] == Material.LEAVES:
                        continue
                    # One plane covers the whole pixel: the point is on the plane, or hidden behind it.
                    normal = np.array([face["normal_0"], face["normal_1"], face["normal_2"]])
                    off = normal @ point - face["offset"]
                    side = np.sign(normal @ other.origin - face["offset"])
                    met += abs(off) < 2e-3
                    through += side * off >= 2e-3
    assert met > 1000
    # A wire can pass between the nine rays of a pixel.
    assert through <= 2e-3 * met


@pytest.mark.parametrize("number", [0, 1])
def test_boxes_enclose_their_masks_to_one_pixel(number: int) -> None:
    shown = 0
    for moment in MOMENTS:
        for seen in views(number, moment):
            mask, camera = seen.view.object, seen.drive.vehicle.cameras[seen.camera]
            for user in np.unique(mask[mask >= 0]):
                place, body = seen.instant.placements[int(user)], seen.drive.road_users[int(user)].body
                middle = place.translation + place.rotation @ (0.0, 0.0, 0.5 * body.size_m[2])
                box = Poses(quaternion_from_matrix(place.rotation[None]), middle[None])
                found = project_boxes(camera, seen.world_SE3_camera.inverse() @ box, np.array([body.size_m]))
                rows, columns = np.nonzero(mask == user)
                left, top, right, bottom = found.bounds_px[0]
                assert found.visible[0]
                assert left <= columns.min() + 1.0 and right >= columns.max(), user
                assert top <= rows.min() + 1.0 and bottom >= rows.max(), user
                shown += 1
    assert shown > 10


def test_ego_masks_cover_all_visible_vehicle_pixels() -> None:
    own = 0
    for seen in everything():
        mask = seen.drive.ego_masks.get(seen.camera)
        ego = seen.view.label == Label.EGO
        own += int(ego.sum())
        assert not (ego & (mask == 0 if mask is not None else True)).any()
    assert own > 100
