"""Computes the radiance along the rays of a view.

Functions that run for every pixel are compiled without reference counts (`mirror.compiled`): counting the
references of each array at every pixel would take a fifth of the time.
"""

from __future__ import annotations

import math
from typing import Final

from mirror.arrays import Float32, Float64, Int32, Int64, Records, UInt8
from mirror.compiled import inner_per_pixel, per_pixel
from mirror.synth.light.sky import sky
from mirror.synth.model import Material
from mirror.synth.render.appearance import image_surface, lamp_surface, plain_surface
from mirror.synth.render.bodywork import bodywork
from mirror.synth.render.carriageway import carriageway
from mirror.synth.render.coverage import SKY
from mirror.synth.render.facades import facade, shopfront, skyline, wall_grain
from mirror.synth.render.lens import TILE_PX
from mirror.synth.render.point_lighting import shade_point
from mirror.synth.render.sample_rays import ray_steps
from mirror.synth.textures.catalogue import Grain
from mirror.synth.textures.sampling import grain_at, image_at

_BRIGHTEST: Final = 4.0


@inner_per_pixel(inline="always")
def shade_ray(
    faces: Records,
    rounds: Records,
    static_shadow: Float32,
    moving_shadow: Float32,
    lamps: Float32,
    glow: Float32,
    ambient_occlusion: Float32,
    ground: Float32,
    dome: Float32,
    clouds: Float32,
    layouts: Records,
    setting: Records,
    maps: Records,
    grains: Float32,
    grain_index: Float64,
    images: UInt8,
    image_index: Int64,
    patterns: Records,
    index: int,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    right: tuple[float, float, float],
    down: tuple[float, float, float],
) -> tuple[float, float, float, float]:
    """Compute the radiance along a ray, and the weight of the mirrored ray (wet ground).

    Arrays are separate arguments: reading one out of a tuple costs two atomic operations per pixel.

    Args:
        faces: (F,) FACE, flat.
        rounds: (R,) ROUND, flat.
        static_shadow: shadow map of what never moves.
        moving_shadow: shadow map of road users and the recording vehicle.
        lamps: map of the street lamps' light over the ground.
        glow: map of the light of other vehicles' headlights over the ground.
        ambient_occlusion: share of the sky's light that road users keep from the ground.
        ground: map of the ground's heights.
        dome: radiance of the clear sky.
        clouds: density of the clouds.
        layouts: (L, K) MARK, flat: markings of carriageways.
        setting: LIGHTING, flat.
        maps: MAPS, flat.
        grains: grains of the atlas.
        grain_index: index of the grains.
        images: images of the atlas.
        image_index: index of the images.
        patterns: table of window patterns.
        index: index of the surface that the ray hits, or SKY.
        ox: camera position, world metres.
        oy: camera position, world metres.
        oz: camera position, world metres.
        dx: unit direction of the ray.
        dy: unit direction of the ray.
        dz: unit direction of the ray.
        right: change of the ray across the footprint, to the right.
        down: change of the ray across the footprint, downwards.
    """
    ax, ay, az = right
    bx, by, bz = down
    if index == SKY:
        r, g, b = sky(dome, clouds, setting, dx, dy, dz, math.sqrt(ax * ax + ay * ay + az * az))
        return r, g, b, 0.0
    if index < len(faces):
        face = faces[index]
        nx, ny, nz = face.normal_0, face.normal_1, face.normal_2
        along = nx * dx + ny * dy + nz * dz
        t = (face.offset - nx * ox - ny * oy - nz * oz) / along
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
        # The displacement of the hit point on the plane from pixel to pixel.
        slip = (nx * ax + ny * ay + nz * az) / along
        ax, ay, az = t * (ax - slip * dx), t * (ay - slip * dy), t * (az - slip * dz)
        slip = (nx * bx + ny * by + nz * bz) / along
        bx, by, bz = t * (bx - slip * dx), t * (by - slip * dy), t * (bz - slip * dz)
        if along > 0.0:
            nx, ny, nz = -nx, -ny, -nz
        u = face.u_axis_0 * x + face.u_axis_1 * y + face.u_axis_2 * z + face.u0
        v = face.v_axis_0 * x + face.v_axis_1 * y + face.v_axis_2 * z + face.v0
        u1 = face.u_axis_0 * ax + face.u_axis_1 * ay + face.u_axis_2 * az
        v1 = face.v_axis_0 * ax + face.v_axis_1 * ay + face.v_axis_2 * az
        u2 = face.u_axis_0 * bx + face.u_axis_1 * by + face.u_axis_2 * bz
        v2 = face.v_axis_0 * bx + face.v_axis_1 * by + face.v_axis_2 * bz
        material, label = face.material, face.label
        if material == Material.ASPHALT:
            rough = grain_at(grains, grain_index, Grain.ASPHALT.value, u, v, u1, v1, u2, v2)
            fr, fg, fb, er, eg, eb, gloss = carriageway(
                face, layouts, rough, u, v, abs(u1) + abs(u2), abs(v1) + abs(v2)
            )
        elif (material == Material.IMAGE or material == Material.LIT_IMAGE) and face.image >= 0:
            fr, fg, fb, er, eg, eb, gloss = image_surface(images, image_index, face, u, v, u1, v1, u2, v2, setting)
        elif (
            material >= Material.GLASS
            and material <= Material.TAIL_LIGHT
            and (material <= Material.RIM or material >= Material.HEADLIGHT)
        ):
            fr, fg, fb, er, eg, eb, gloss = bodywork(face, u, v, abs(u1) + abs(u2), abs(v1) + abs(v2), setting)
        elif material == Material.STREET_LAMP or material == Material.SIGNAL:
            fr, fg, fb, er, eg, eb, gloss = lamp_surface(face, setting)
        elif material == Material.FACADE:
            rough = grain_at(grains, grain_index, wall_grain(face, patterns), u, v, u1, v1, u2, v2)
            fr, fg, fb, er, eg, eb, gloss = facade(
                face, patterns, rough, u, v, abs(u1) + abs(u2), abs(v1) + abs(v2), setting
            )
        elif material == Material.SHOPFRONT:
            wide, high = 0.5 / face.half_0, 0.5 / face.half_1
            sr, sg, sb = image_at(
                images, image_index, face.image, 0.5 + u * wide, 0.5 + v * high,
                u1 * wide, v1 * high, u2 * wide, v2 * high,
            )  # fmt: skip
            fr, fg, fb, er, eg, eb, gloss = shopfront(
                face, sr, sg, sb, u, v, abs(u1) + abs(u2), abs(v1) + abs(v2), setting
            )
        elif material == Material.SKYLINE:
            fr, fg, fb, er, eg, eb, gloss = skyline(face, u, v, abs(u1) + abs(u2), abs(v1) + abs(v2))
        else:
            fr, fg, fb, er, eg, eb, gloss = plain_surface(
                grains, grain_index, material, face.seed, (face.colour_0, face.colour_1, face.colour_2),
                u, v, u1, v1, u2, v2,
            )  # fmt: skip
    else:
        ball = rounds[index - len(faces)]
        material, label = ball.material, ball.label
        x, y, z = ox - ball.centre_0, oy - ball.centre_1, oz - ball.centre_2
        hx, hy, hz = 1.0 / ball.half_0, 1.0 / ball.half_1, 1.0 / ball.half_2
        px = (ball.axes_00 * x + ball.axes_01 * y + ball.axes_02 * z) * hx
        py = (ball.axes_10 * x + ball.axes_11 * y + ball.axes_12 * z) * hy
        pz = (ball.axes_20 * x + ball.axes_21 * y + ball.axes_22 * z) * hz
        vx = (ball.axes_00 * dx + ball.axes_01 * dy + ball.axes_02 * dz) * hx
        vy = (ball.axes_10 * dx + ball.axes_11 * dy + ball.axes_12 * dz) * hy
        vz = (ball.axes_20 * dx + ball.axes_21 * dy + ball.axes_22 * dz) * hz
        qa, qb = vx * vx + vy * vy + vz * vz, px * vx + py * vy + pz * vz
        qc = px * px + py * py + pz * pz - 1.0
        # A mean of rays near the edge may miss the ellipsoid by a little; then the ray is taken as tangent.
        t = (-qb - math.sqrt(max(qb * qb - qa * qc, 0.0))) / qa
        px, py, pz = px + t * vx, py + t * vy, pz + t * vz
        nx = ball.axes_00 * px * hx + ball.axes_10 * py * hy + ball.axes_20 * pz * hz
        ny = ball.axes_01 * px * hx + ball.axes_11 * py * hy + ball.axes_21 * pz * hz
        nz = ball.axes_02 * px * hx + ball.axes_12 * py * hy + ball.axes_22 * pz * hz
        scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx * scale, ny * scale, nz * scale
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
        wide = t * math.sqrt(ax * ax + ay * ay + az * az)
        if ball.image >= 0 and px > 0.0:
            step = 0.5 * wide
            fr, fg, fb = image_at(
                images, image_index, ball.image, 0.5 + 0.5 * py, 0.5 + 0.5 * pz, step * hy, 0.0, 0.0, step * hz
            )
            er, eg, eb, gloss = 0.0, 0.0, 0.0, 0.01
        else:
            # The grain is projected along the dominant axis of the normal, in the frame of the body.
            ix, iy, iz = abs(px * hx), abs(py * hy), abs(pz * hz)
            if iz > ix and iz > iy:
                u, v = px * ball.half_0, py * ball.half_1
            elif ix > iy:
                u, v = py * ball.half_1, pz * ball.half_2
            else:
                u, v = px * ball.half_0, pz * ball.half_2
            fr, fg, fb, er, eg, eb, gloss = plain_surface(
                grains, grain_index, material, ball.seed, (ball.colour_0, ball.colour_1, ball.colour_2),
                u, v, wide, 0.0, 0.0, wide,
            )  # fmt: skip
    return shade_point(
        static_shadow, moving_shadow, lamps, glow, ambient_occlusion, ground, dome, clouds, setting, maps,
        material, label, t, x, y, z, nx, ny, nz, dx, dy, dz, fr, fg, fb, er, eg, eb, gloss,
    )  # fmt: skip


@per_pixel()
def render_radiance(
    faces: Records,
    rounds: Records,
    static_shadow: Float32,
    moving_shadow: Float32,
    lamps: Float32,
    glow: Float32,
    ambient_occlusion: Float32,
    ground: Float32,
    dome: Float32,
    clouds: Float32,
    layouts: Records,
    setting: Records,
    maps: Records,
    grains: Float32,
    grain_index: Float64,
    images: UInt8,
    image_index: Int64,
    patterns: Records,
    rays: Float64,
    rotation: Float64,
    origin: Float64,
    offset: Float32,
    scale: float,
    centre: Int32,
    mixed: UInt8,
    which: Int32,
    share: Float32,
    mask: Float32,
    out: Float32,
) -> None:
    """Compute the radiance of an image from the result of `coverage.compute_coverage`.

    Args:
        faces: (F,) FACE, flat.
        rounds: (R,) ROUND, flat.
        static_shadow: shadow map of what never moves.
        moving_shadow: shadow map of road users and the recording vehicle.
        lamps: map of the street lamps' light over the ground.
        glow: map of the light of other vehicles' headlights over the ground.
        ambient_occlusion: share of the sky's light that road users keep from the ground.
        ground: map of the ground's heights.
        dome: radiance of the clear sky.
        clouds: density of the clouds.
        layouts: (L, K) MARK, flat: markings of carriageways.
        setting: LIGHTING, flat.
        maps: MAPS, flat.
        grains: grains of the atlas.
        grain_index: index of the grains.
        images: images of the atlas.
        image_index: index of the images.
        patterns: table of window patterns.
        rays: (H, W, 3) rays of the lens.
        rotation: (3, 3) world_R_camera.
        origin: (3,) camera position, world metres.
        offset: (2,) offset of the ray that ``centre`` belongs to, pixels.
        scale: width of the footprint, pixels.
        centre: from `compute_coverage`.
        mixed: from `compute_coverage`.
        which: from `compute_coverage`.
        share: from `compute_coverage`.
        mask: the mask given to `compute_coverage`.
        out: (H, W, 4) output where ``mask`` is set: red, green, blue, and the weight of the mirrored image.
    """
    height, width = rays.shape[:2]
    ox, oy, oz = origin[0], origin[1], origin[2]
    at = 0
    for top in range(0, height, TILE_PX):
        for left in range(0, width, TILE_PX):
            bottom, right = min(top + TILE_PX, height) - 1, min(left + TILE_PX, width) - 1
            ax, ay, az, bx, by, bz = ray_steps(rays, rotation, top, left, bottom, right)
            for row in range(top, bottom + 1):
                for column in range(left, right + 1):
                    if mask.shape[0] > 0 and mask[row, column] <= 0.0:
                        while at < len(which) and which[at, 0] == row * width + column:
                            at += 1
                        continue
                    i, j, k = rays[row, column, 0], rays[row, column, 1], rays[row, column, 2]
                    x = rotation[0, 0] * i + rotation[0, 1] * j + rotation[0, 2] * k
                    y = rotation[1, 0] * i + rotation[1, 1] * j + rotation[1, 2] * k
                    z = rotation[2, 0] * i + rotation[2, 1] * j + rotation[2, 2] * k
                    r, g, b, m = 0.0, 0.0, 0.0, 0.0
                    first, last = at, at + 1
                    if mixed[row, column]:
                        while last < len(which) and which[last, 0] == which[first, 0]:
                            last += 1
                        at = last
                    for piece in range(first, last):
                        index, weight, u, v = centre[row, column], 1.0, offset[0], offset[1]
                        if mixed[row, column]:
                            index, weight, u, v = which[piece, 1], share[piece, 0], share[piece, 1], share[piece, 2]
                        dx, dy, dz = x + u * ax + v * bx, y + u * ay + v * by, z + u * az + v * bz
                        pr, pg, pb, pm = shade_ray(
                            faces, rounds, static_shadow, moving_shadow, lamps, glow, ambient_occlusion, ground,
                            dome, clouds, layouts, setting, maps, grains, grain_index, images, image_index, patterns,
                            index, ox, oy, oz, dx, dy, dz,
                            (scale * ax, scale * ay, scale * az), (scale * bx, scale * by, scale * bz),
                        )  # fmt: skip
                        # Bright lamps are clipped before averaging; otherwise their edges would be aliased.
                        r += weight * min(pr, _BRIGHTEST)
                        g += weight * min(pg, _BRIGHTEST)
                        b += weight * min(pb, _BRIGHTEST)
                        m += weight * pm
                    out[row, column, 0], out[row, column, 1], out[row, column, 2] = r, g, b
                    out[row, column, 3] = m
