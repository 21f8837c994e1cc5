"""Measures time and error of poses and cameras, for MIRROR and its peers.

``python -m benchmarks geometry [--size N]`` prints rows ``name, size, ms, error, peer`` and plots time against error.
Errors are the largest of a sample, compared with the same formulas in 80-bit floats: for a pose of the matrix entries
(translations of about 100 m), for a pixel the distance in pixels, for a ray the distance in pixels between the input
pixel and the image of the ray.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from functools import partial
from itertools import chain

import numpy as np
import numpy.typing as npt

from benchmarks.report import Peer, Row, best_ms, report
from mirror.arrays import AnyArray, Float64, Int64
from mirror.geometry import Camera, Poses, interpolate, project_boxes, quaternion_from_matrix, quaternion_normalise

SAMPLE = 5_000
TRACK = 10_000
Long = npt.NDArray[np.longdouble]


def full_hd(model: str, fx_px: float, fy_px: float, *distortion: float) -> Camera:
    return Camera(model, 1920, 1080, fx_px, fy_px, 955.3, 545.1, distortion)


CAMERAS = (
    full_hd("pinhole", 1100.0, 1105.0),
    full_hd("brown_conrady", 1100.0, 1105.0, -0.3, 0.1, 1e-3, -5e-4, -0.01),
    full_hd("rational", 1100.0, 1105.0, 8.0, 3.0, 1e-3, -5e-4, 0.05, 8.3, 5.0, 0.3),
    full_hd("kannala_brandt", 600.0, 601.0, 0.05, -0.01, 0.003, -0.001),
    full_hd("f_theta", 1.0, 1.0, 0.0, 620.0, 3.0, -20.0, 2.0),
)


def largest(values: AnyArray) -> float:
    return float(np.nanmax(np.abs(values)))


def to_matrices(rotation: Float64, translation: Float64) -> Long:
    """Return the homogeneous matrices of poses in 80-bit floats."""
    w, x, y, z = rotation.astype(np.longdouble).T
    square = w * w + x * x + y * y + z * z
    matrix = np.zeros((len(rotation), 4, 4), dtype=np.longdouble)
    matrix[:, 0, :3] = np.stack((w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)), axis=-1)
    matrix[:, 1, :3] = np.stack((2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)), axis=-1)
    matrix[:, 2, :3] = np.stack((2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z), axis=-1)
    matrix /= square[:, None, None]
    matrix[:, :3, 3], matrix[:, 3, 3] = translation, 1
    return matrix


def multiply(first: Long, second: Long) -> Long:
    return np.asarray(np.einsum("...ij,...jk->...ik", first, second))


def pose_error(matrices: AnyArray, expected: Long) -> float:
    return largest(matrices - expected)


def random_poses(size: int, seed: int) -> Poses:
    generator = np.random.default_rng(seed)
    return Poses(generator.normal(size=(size, 4)), generator.normal(size=(size, 3)) * 40.0)


def pose_rows(size: int) -> Iterator[Row]:
    from scipy.spatial.transform import RigidTransform, Rotation

    first, second = random_poses(size, 0), random_poses(size, 1)
    points = np.random.default_rng(2).normal(size=(size, 3)) * 40.0
    few = slice(0, SAMPLE)
    first_long, second_long = (to_matrices(one.rotation[few], one.translation[few]) for one in (first, second))

    def rigid(poses: Poses) -> RigidTransform:
        return RigidTransform.from_components(poses.translation, Rotation.from_quat(poses.rotation, scalar_first=True))

    first_rigid, second_rigid = rigid(first), rigid(second)
    expected = multiply(first_long, second_long)
    yield Row(
        "compose",
        f"{size:,}",
        best_ms(lambda: first @ second),
        pose_error((first[few] @ second[few]).matrix(), expected),
        (
            Peer(
                "scipy",
                best_ms(lambda: first_rigid * second_rigid),
                pose_error((first_rigid[few] * second_rigid[few]).as_matrix(), expected),
            ),
        ),
    )
    homogeneous = np.concatenate((points[few], np.ones((SAMPLE, 1))), axis=1).astype(np.longdouble)[..., None]
    for name, count, many in (("transform, one pose", 1, first[:1]), ("transform, a pose each", size, first)):
        shaped = points[None] if count == 1 else points[:, None]
        of = rigid(many) if count > 1 else rigid(many)[0]
        expected = multiply(first_long[:1] if count == 1 else first_long, homogeneous)[:, :3, 0]
        yield Row(
            name,
            f"{size:,}",
            best_ms(partial(many.transform, shaped)),
            largest(many.transform(shaped).reshape(-1, 3)[few] - expected),
            (Peer("scipy", best_ms(partial(of.apply, points)), largest(of.apply(points)[few] - expected)),),
        )
    twist = first.log()
    yield Row(
        "log, then exp",
        f"{size:,}",
        best_ms(lambda: Poses.exp(first.log())),
        pose_error(Poses.exp(twist[few]).matrix(), first_long),
        (
            Peer(
                "scipy",
                best_ms(lambda: RigidTransform.from_exp_coords(first_rigid.as_exp_coords()), 1),
                pose_error(RigidTransform.from_exp_coords(first_rigid[few].as_exp_coords()).as_matrix(), first_long),
            ),
        ),
    )
    matrices = first.matrix()[:, :3, :3]
    back = quaternion_from_matrix(matrices[few])
    theirs = Rotation.from_matrix(matrices[few]).as_quat(canonical=True, scalar_first=True)
    yield Row(
        "quaternion from matrix",
        f"{size:,}",
        best_ms(lambda: quaternion_from_matrix(matrices)),
        largest(back - first.rotation[few]),
        (
            Peer(
                "scipy",
                best_ms(lambda: Rotation.from_matrix(matrices), 1),
                largest(theirs - first.rotation[few]),
            ),
        ),
    )


def slerp_long(first: Float64, second: Float64, fraction: Long) -> Long:
    a, b = first.astype(np.longdouble), second.astype(np.longdouble)
    a, b = (one / np.sqrt(np.sum(one * one, axis=1, keepdims=True)) for one in (a, b))
    b = b * np.where(np.sum(a * b, axis=1, keepdims=True) < 0, -1, 1)
    angle = 2 * np.arctan2(np.sqrt(np.sum((b - a) ** 2, axis=1)), np.sqrt(np.sum((b + a) ** 2, axis=1)))[:, None]
    share = fraction[:, None]
    turned = (np.sin((1 - share) * angle) * a + np.sin(share * angle) * b) / np.sin(angle)
    return np.asarray(turned * np.where(turned[:, :1] < 0, -1, 1))


def interpolation_rows(size: int) -> Iterator[Row]:
    from scipy.spatial.transform import Rotation, Slerp

    generator = np.random.default_rng(0)
    stamps = 1_700_000_000_000_000_000 + np.cumsum(generator.integers(4_000_000, 6_000_000, TRACK))
    turns = Poses.exp(np.cumsum(generator.normal(size=(TRACK, 6)) * 0.01, axis=0)).rotation
    track = Poses(turns, np.cumsum(generator.normal(size=(TRACK, 3)) * 0.1, axis=0))
    query = generator.integers(stamps[0], stamps[-1], size)
    rotations = Rotation.from_quat(track.rotation, scalar_first=True)

    start = np.searchsorted(stamps, query[:SAMPLE], side="right") - 1
    span = (stamps[start + 1] - stamps[start]).astype(np.longdouble)
    fraction = (query[:SAMPLE] - stamps[start]).astype(np.longdouble) / span
    expected = slerp_long(track.rotation[start], track.rotation[start + 1], fraction)

    def peer(stamps_ns: Int64) -> Float64:
        slerp = Slerp((stamps - stamps[0]) * 1e-9, rotations)
        return np.asarray(slerp((stamps_ns - stamps[0]) * 1e-9).as_quat(canonical=True, scalar_first=True))

    for name, stamps_ns in (("interpolate, any order", query), ("interpolate, in order", np.sort(query))):
        yield Row(
            name,
            f"{size:,} of {TRACK:,}",
            best_ms(partial(interpolate, stamps, track, stamps_ns)),
            largest(interpolate(stamps, track, query[:SAMPLE]).rotation - expected),
            (
                Peer(
                    "scipy Slerp (turn only)",
                    best_ms(partial(peer, stamps_ns)),
                    largest(peer(query[:SAMPLE]) - expected),
                ),
            ),
        )
    yield Row(
        "interpolate, one stamp",
        f"1 of {TRACK:,}",
        best_ms(lambda: interpolate(stamps, track, query[:1]), 200),
        largest(interpolate(stamps, track, query[:1]).rotation - expected[:1]),
        (
            Peer(
                "scipy Slerp (turn only)", best_ms(lambda: peer(query[:1]), 50), largest(peer(query[:1]) - expected[:1])
            ),
        ),
    )


def project_long(camera: Camera, points: AnyArray) -> Long:
    """Return the documented formulas of every camera model in 80-bit floats."""
    x, y, z = points.astype(np.longdouble).T
    if camera.lens.forward_only:
        x, y = x / z, y / z
        square = x * x + y * y
        k1, k2, p1, p2, k3, k4, k5, k6 = (*camera.distortion, *(0.0,) * (8 - len(camera.distortion)))
        factor = (1 + square * (k1 + square * (k2 + square * k3))) / (1 + square * (k4 + square * (k5 + square * k6)))
        u = x * factor + 2 * p1 * x * y + p2 * (square + 2 * x * x)
        v = y * factor + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    else:
        across = np.sqrt(x * x + y * y)
        angle = np.arctan2(across, z)
        if camera.model == "f_theta":
            radius = sum(value * angle**power for power, value in enumerate(camera.distortion))
        else:
            radius = angle + sum(value * angle ** (3 + 2 * power) for power, value in enumerate(camera.distortion))
        u, v = radius * x / across, radius * y / across
    return np.stack((u * camera.fx_px + camera.cx_px, v * camera.fy_px + camera.cy_px), axis=-1)


def camera_rows(size: int) -> Iterator[Row]:
    generator = np.random.default_rng(0)
    pixels = generator.uniform((0.0, 0.0), (1920.0, 1080.0), (size, 2))
    for camera in CAMERAS:
        points = camera.unproject(pixels).direction * generator.uniform(0.5, 80.0, (size, 1))
        if not camera.lens.forward_only:
            # OpenCV's fisheye sees no farther than 90 degrees, and inverts no radius beyond pi / 2 focal lengths: in
            # this camera's corners that is its error.
            points[:, 2] = np.maximum(points[:, 2], 0.01)
        seen = camera.project(points).uv_px
        exact = project_long(camera, points[:SAMPLE])
        project_peer, unproject_peers = opencv_peers(camera, points, seen, exact)
        yield Row(
            f"project, {camera.model}",
            f"{size:,}",
            best_ms(partial(camera.project, points)),
            largest(seen[:SAMPLE] - exact),
            project_peer,
        )
        rays = camera.unproject(seen[:SAMPLE])
        yield Row(
            f"unproject, {camera.model}",
            f"{size:,}",
            best_ms(partial(camera.unproject, seen)),
            largest(project_long(camera, rays.direction) - seen[:SAMPLE]),
            unproject_peers,
        )


def opencv_peers(
    camera: Camera, points: Float64, seen: Float64, exact: Long
) -> tuple[tuple[Peer, ...], tuple[Peer, ...]]:
    """Measure OpenCV's time and error for the same points.

    Projection, and its inverse with few and with many iterations.
    """
    import cv2

    if camera.model == "f_theta":
        return (), ()
    matrix, zero = camera.intrinsic_matrix(first_pixel_centre=0.0), np.zeros(3)
    distortion = np.array(camera.distortion or (0.0,) * 4)
    few, shifted = slice(0, SAMPLE), seen - 0.5
    patient = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-15)

    def project(given: Float64) -> AnyArray:
        if camera.model == "kannala_brandt":
            return cv2.fisheye.projectPoints(given[:, None], zero, zero, matrix, distortion)[0][:, 0]
        return cv2.projectPoints(given, zero, zero, matrix, distortion)[0][:, 0]

    def unproject(given: Float64, criteria: tuple[int, int, float]) -> AnyArray:
        if camera.model == "kannala_brandt":
            return cv2.fisheye.undistortPoints(given[:, None], matrix, distortion, criteria=criteria)[:, 0]
        return cv2.undistortPoints(given, matrix, distortion, criteria=criteria)[:, 0]

    def unproject_error(criteria: tuple[int, int, float]) -> float:
        plane = unproject(shifted[few], criteria)
        return largest(project_long(camera, np.concatenate((plane, np.ones((SAMPLE, 1))), axis=1)) - seen[few])

    default = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 10 if camera.model == "kannala_brandt" else 5, 1e-8)
    return (
        (Peer("OpenCV", best_ms(lambda: project(points)), largest(project(points[few]) + 0.5 - exact)),),
        tuple(
            Peer(name, best_ms(partial(unproject, shifted, criteria), repeats), unproject_error(criteria))
            for name, criteria, repeats in (("OpenCV", default, 3), ("OpenCV, 100 iterations", patient, 1))
        ),
    )


def box_rows(count: int) -> Iterator[Row]:
    generator = np.random.default_rng(0)
    poses = Poses(
        quaternion_normalise(generator.normal(size=(count, 4))),
        generator.uniform((-20, -3, 2), (20, 3, 60), (count, 3)),
    )
    sizes = np.tile((4.5, 1.9, 1.6), (count, 1))
    grid = np.stack(np.meshgrid(*(np.linspace(-0.5, 0.5, 41),) * 3), axis=-1).reshape(-1, 3)
    surface = grid[(np.abs(grid) == 0.5).any(axis=1)]
    for camera in CAMERAS:
        boxes = project_boxes(camera, poses, sizes)
        # The largest distance of a dense sample of the surface beyond the bounds.
        sample = camera.project(poses[:50].transform(surface * sizes[0]))
        inside = np.where(sample.valid[..., None], sample.uv_px, np.nan)
        seen = sample.valid.any(axis=1)
        short = np.fmax(
            boxes.bounds_px[:50, :2] - np.fmin.reduce(inside, axis=1),
            np.fmax.reduce(inside, axis=1) - boxes.bounds_px[:50, 2:],
        )
        error = max(0.0, float(np.max(short[seen], initial=0.0)))
        ms = best_ms(partial(project_boxes, camera, poses, sizes))
        yield Row(f"project boxes, {camera.model}", f"{count:,}", ms, error, unit="px")


def main(argv: list[str]) -> int:
    """Run the benchmark and print its rows."""
    parser = argparse.ArgumentParser(
        prog="benchmarks geometry", description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument("--size", type=int, default=1_000_000, help="poses, stamps and points")
    options = parser.parse_args(argv)
    return report(
        "geometry",
        {
            "poses": chain(pose_rows(options.size), interpolation_rows(options.size)),
            "cameras": chain(camera_rows(options.size), box_rows(1000)),
        },
        errors="largest error (matrix entry, m, px)",
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
