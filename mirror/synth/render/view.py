"""One view of a scene: visible surfaces, radiance and ground truth of its pixels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float32, Float64, Int32, Int64, Records, UInt8
from mirror.portable import arrays
from mirror.synth.model import Label
from mirror.synth.render.binning import build_tile_lists, find_facing
from mirror.synth.render.coverage import SKY, compute_coverage
from mirror.synth.render.lens import Lens
from mirror.synth.render.sample_rays import OFFSETS
from mirror.synth.render.shade import render_radiance
from mirror.synth.render.surroundings import Surroundings
from mirror.synth.street.houses.windows import pattern_table
from mirror.synth.textures.atlas import atlas

_EVERYWHERE: Final = np.zeros((0, 0), np.float32)
_SMALLEST_PX: Final = 0.1
_PATTERNS: Final = pattern_table()


@dataclass(frozen=True, eq=False)
class RasterizedView:
    """The visible surfaces of a scene from a camera.

    Attributes:
        scene: the rendered scene.
        lens: rays of the camera.
        rotation: (3, 3) world_R_camera.
        origin: (3,) camera position, world metres.
        offsets: (S, 2) rays of a pixel, in pixels from its centre.
        mask: (H, W) mask of the pixels to be rendered; (0, 0): all.
        surface: (H, W) surface (faces, then ellipsoids) that a pixel's first ray hits, or SKY.
        mixed: (H, W) 1 where the rays of a pixel hit different surfaces.
        which: (K, 2) pixel and surface of the fragments of such pixels.
        share: (K, 3) their shares of the rays, and their mean offsets.
        counts: numbers of all surfaces, of surfaces that face the camera, of listed and of tested pairs of tile and
            surface, and of tiles.
    """

    scene: Surroundings
    lens: Lens
    rotation: Float64
    origin: Float64
    offsets: Float32
    mask: Float32
    surface: Int32
    mixed: UInt8
    which: Int32
    share: Float32
    counts: dict[str, int]

    def radiance(self, footprint_px: float = 1.0) -> Float32:
        """Compute the radiance (H, W, 4): red, green, blue, and the weight of the mirrored image.

        Args:
            footprint_px: width over which textures are averaged.
        """
        scene, textures = self.scene, atlas()
        out = np.zeros((*self.lens.rays.shape[:2], 4), np.float32)
        render_radiance(
            scene.faces, scene.rounds, scene.static_shadow, scene.moving_shadow, scene.lamps, scene.glow,
            scene.ambient_occlusion, scene.ground,
            scene.dome, scene.clouds, scene.layouts, scene.setting, scene.maps,
            textures.grains, textures.grain_index, textures.images, textures.image_index, _PATTERNS,
            self.lens.rays, self.rotation, self.origin, self.offsets[0], footprint_px,
            self.surface, self.mixed, self.which, self.share, self.mask, out,
        )  # fmt: skip
        return out

    @cached_property
    def _geometry(self) -> tuple[Float32, Float32]:
        scene = self.scene
        return _geometry_of(scene.faces, scene.rounds, self.lens.rays, self.rotation, self.origin, self.surface)

    @property
    def distance_m(self) -> Float32:
        """Distances (H, W) along the rays through the pixel centres, metres; infinite for the sky."""
        return self._geometry[0]

    @property
    def normal(self) -> Float32:
        """Unit normals (H, W, 3) in the world frame, towards the camera; 0 for the sky."""
        return self._geometry[1]

    @property
    def camera_normal(self) -> Float32:
        """Unit normals (H, W, 3) in the camera frame, towards the camera; 0 for the sky."""
        return arrays.matmul(self.normal, self.rotation).astype(np.float32)

    def _of_surfaces(self, name: str, sky: int) -> Int64:
        values = np.full(self.surface.shape, sky, np.int64)
        number = len(self.scene.faces)
        # Records are read where a pixel shows them: all of a street are 10 MB.
        is_face, is_round = (self.surface != SKY) & (self.surface < number), self.surface >= number
        values[is_face] = self.scene.faces[name][self.surface[is_face]]
        values[is_round] = self.scene.rounds[name][self.surface[is_round] - number]
        return values

    @property
    def label(self) -> UInt8:
        """Semantic classes (H, W): values of `Label`."""
        return self._of_surfaces("label", Label.SKY).astype(np.uint8)

    @property
    def object(self) -> Int32:
        """Numbers (H, W) of the visible road users; NO_OBJECT elsewhere."""
        return self._of_surfaces("object", -1).astype(np.int32)


def rasterize_view(
    scene: Surroundings,
    lens: Lens,
    rotation: Float64,
    origin: Float64,
    *,
    offsets: Float32 = OFFSETS,
    mask: Float32 = _EVERYWHERE,
    ground: bool = True,
) -> RasterizedView:
    """Find the surfaces that a camera sees.

    Args:
        scene: the scene.
        lens: rays of the camera.
        rotation: (3, 3) world_R_camera.
        origin: (3,) camera position, world metres.
        offsets: (S, 2) rays of a pixel, in pixels from its centre; the first gives the ground truth.
        mask: (H, W) mask of the pixels to be rendered; default: all.
        ground: whether the ground is rendered.
    """
    rotation = np.ascontiguousarray(rotation, np.float64)
    x, y, z = (float(value) for value in origin)
    order, nearest, aims, starts = find_facing(
        scene.faces,
        scene.spheres,
        lens.cones,
        lens.levels,
        rotation,
        x,
        y,
        z,
        0.5 * _SMALLEST_PX * lens.pixel_rad,
        ground,
    )
    begins, lists, rows, filled = build_tile_lists(
        scene.faces, scene.corners, scene.rounds, order, nearest, aims, starts,
        lens.cones, lens.levels, lens.cells, lens.cell_tiles, lens.small, rotation, x, y, z,
    )  # fmt: skip
    surface, mixed, which, share, counts = compute_coverage(
        scene.faces, scene.corners, scene.rounds, lens.rays, rotation, x, y, z, offsets, lens.cones, begins, lists,
        order, nearest, aims, starts, rows, filled, mask,
    )  # fmt: skip
    counted = {
        "surfaces": len(scene.spheres), "facing": len(order), "near": len(lists), "tried": int(counts[1]),
        "tiles": int(counts[0]),
    }  # fmt: skip
    return RasterizedView(
        scene, lens, rotation, np.array([x, y, z]), offsets, mask, surface, mixed, which, share, counted
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _geometry_of(
    faces: Records, rounds: Records, rays: Float64, rotation: Float64, origin: Float64, surface: Int32
) -> tuple[Float32, Float32]:
    height, width = surface.shape
    distance, normal = np.empty((height, width), np.float32), np.zeros((height, width, 3), np.float32)
    for row in range(height):
        for column in range(width):
            index = surface[row, column]
            if index == SKY:
                distance[row, column] = np.inf
                continue
            i, j, k = rays[row, column, 0], rays[row, column, 1], rays[row, column, 2]
            dx = rotation[0, 0] * i + rotation[0, 1] * j + rotation[0, 2] * k
            dy = rotation[1, 0] * i + rotation[1, 1] * j + rotation[1, 2] * k
            dz = rotation[2, 0] * i + rotation[2, 1] * j + rotation[2, 2] * k
            if index < len(faces):
                face = faces[index]
                nx, ny, nz = face.normal_0, face.normal_1, face.normal_2
                along = nx * dx + ny * dy + nz * dz
                t = (face.offset - nx * origin[0] - ny * origin[1] - nz * origin[2]) / along
            else:
                ball = rounds[index - len(faces)]
                x, y, z = origin[0] - ball.centre_0, origin[1] - ball.centre_1, origin[2] - ball.centre_2
                px = (ball.axes_00 * x + ball.axes_01 * y + ball.axes_02 * z) / ball.half_0
                py = (ball.axes_10 * x + ball.axes_11 * y + ball.axes_12 * z) / ball.half_1
                pz = (ball.axes_20 * x + ball.axes_21 * y + ball.axes_22 * z) / ball.half_2
                vx = (ball.axes_00 * dx + ball.axes_01 * dy + ball.axes_02 * dz) / ball.half_0
                vy = (ball.axes_10 * dx + ball.axes_11 * dy + ball.axes_12 * dz) / ball.half_1
                vz = (ball.axes_20 * dx + ball.axes_21 * dy + ball.axes_22 * dz) / ball.half_2
                a, b = vx * vx + vy * vy + vz * vz, px * vx + py * vy + pz * vz
                c = px * px + py * py + pz * pz - 1.0
                t = (-b - np.sqrt(max(b * b - a * c, 0.0))) / a
                px, py, pz = (px + t * vx) / ball.half_0, (py + t * vy) / ball.half_1, (pz + t * vz) / ball.half_2
                nx = ball.axes_00 * px + ball.axes_10 * py + ball.axes_20 * pz
                ny = ball.axes_01 * px + ball.axes_11 * py + ball.axes_21 * pz
                nz = ball.axes_02 * px + ball.axes_12 * py + ball.axes_22 * pz
                scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz)
                nx, ny, nz = nx * scale, ny * scale, nz * scale
                along = nx * dx + ny * dy + nz * dz
            sign = -1.0 if along > 0.0 else 1.0
            distance[row, column] = t
            normal[row, column, 0] = sign * nx
            normal[row, column, 1] = sign * ny
            normal[row, column, 2] = sign * nz
    return distance, normal
