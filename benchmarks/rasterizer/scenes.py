"""Seeded Gaussians to time and check the rasterizer: random ones, needles, a street block, a captured garden.

Scenes use only sums, products, quotients and square roots of the generator's bits: the arrays, and `Splats.digest`, are
the same on every machine. Worlds have z up and their origin within two metres of the camera.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mirror.arrays import AnyArray, Float32, Float64

SH_DC = 0.28209479177387814
_FORWARD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # camera from a world of x ahead, z up


@dataclass(frozen=True)
class Splats:
    """Gaussians of a benchmark scene, and the camera that sees them.

    Attributes:
        name: name of the scene.
        means: (N, 3) metres.
        quats: (N, 4) wxyz, not normalised.
        scales: (N, 3) standard deviations, metres.
        opacities: (N,) in 0..1.
        colors: (N, 3) in 0..1.
        viewmat: (4, 4) camera from world.
        focal: fx / width and fy / height.
    """

    name: str
    means: Float32
    quats: Float32
    scales: Float32
    opacities: Float32
    colors: Float32
    viewmat: Float64 = field(repr=False)
    focal: tuple[float, float]

    def __len__(self) -> int:
        """Number of Gaussians."""
        return len(self.means)

    def camera_matrix(self, width: int, height: int) -> Float64:
        """Return the intrinsics (3, 3) for an image of this size; the principal point is its middle."""
        fx, fy = self.focal
        return np.array([[fx * width, 0.0, width / 2], [0.0, fy * height, height / 2], [0.0, 0.0, 1.0]])

    def spherical_harmonics(self) -> Float32:
        """Return the coefficients (N, 16, 3) of degree 3 with the mean colour `colors`."""
        random = np.random.Generator(np.random.PCG64(3))
        coefficients = 0.2 * (random.random((len(self), 16, 3), np.float32) - np.float32(0.5))
        coefficients[:, 0] = (self.colors - np.float32(0.5)) / np.float32(SH_DC)
        return coefficients.astype(np.float32)

    @property
    def digest(self) -> str:
        """SHA-256 of all arrays, including the camera."""
        parts = (self.means, self.quats, self.scales, self.opacities, self.colors, self.viewmat, np.array(self.focal))
        return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


def random(count: int) -> Splats:
    """Make roundish Gaussians, uniform in the view frustum from 2 to 12 m."""
    return _volume("random", count, np.array([1.0, 1.0, 1.0]), seed=1)


def needles(count: int) -> Splats:
    """Make Gaussians as `random` does, each a hundred times as long as thick."""
    return _volume("needles", count, np.array([10.0, 0.1, 0.1]), seed=2)


def hairs(count: int) -> Splats:
    """Make Gaussians as `random` does, each ten thousand times as long as thick: thinner than a pixel."""
    return _volume("hairs", count, np.array([10.0, 0.001, 0.001]), seed=6)


def garden(folder: Path) -> Splats:
    """Load the captured cloud that gsplat is tested with; sizes are from the three nearest neighbours.

    Args:
        folder: folder with ``test_garden.npz``.
    """
    from scipy.spatial import cKDTree

    with np.load(folder / "test_garden.npz") as file:
        means, colors, viewmats, cameras = (file[name] for name in ("means3d", "colors", "viewmats", "Ks"))
        width, height = int(file["width"]), int(file["height"])
    _, near = cKDTree(means).query(means, 4)
    away = means[near[:, 1:]].astype(np.float64) - means[:, None]
    spacing = np.sqrt((away[..., 0] ** 2 + away[..., 1] ** 2 + away[..., 2] ** 2).min(axis=1))
    draw = np.random.Generator(np.random.PCG64(4)).random
    size = np.maximum(spacing, 1e-4)[:, None] * 0.4 / (1.0 - 0.85 * draw((len(means), 3)))
    focal = float(cameras[0, 0, 0]) / width, float(cameras[0, 1, 1]) / height
    quats, opacities = 2 * draw((len(means), 4)) - 1, 0.05 + 0.9 * draw(len(means))
    return _splats("garden", means, quats, size, opacities, colors / 255.0, viewmats[0].astype(np.float64), focal)


def street(count: int) -> Splats:
    """Make a street block of 100 m: ground, facades, trees, wires, cars and a sky.

    The cameras are 1.6 m above the ground.
    """
    draw = np.random.Generator(np.random.PCG64(5)).random
    shares = {_ground: 0.27, _facades: 0.30, _foliage: 0.25, _lines: 0.04, _cars: 0.11, _sky: 0.03}
    counts = [int(count * share) for share in shares.values()]
    counts[0] += count - sum(counts)
    parts = [make(draw, number) for make, number in zip(shares, counts)]
    order = np.argsort(draw(count), kind="stable")
    means, quats, scales, opacities, colors = (np.concatenate(arrays)[order] for arrays in zip(*parts))
    viewmat = _viewmat(np.array([0.0, 0.0, 1.6]), 1.0 / 64)
    return _splats("street", means, quats, scales, opacities, colors, viewmat, (0.6, 0.6 * 16 / 9))


Draw = Callable[..., Float64]
Part = tuple[Float64, Float64, Float64, Float64, Float64]
_LENGTH = 100.0
_KERB, _WALL, _HEIGHT = 6.0, 10.0, 14.0


def _ground(draw: Draw, count: int) -> Part:
    """A flat road and its pavements, with lane markings; fine Gaussians over broad ones."""
    ahead = draw(count)
    x, y = _along(ahead), 24.0 * draw(count) - 12.0
    size = np.minimum(_sizes(draw, count, 165.0 * 24.0) * np.sqrt(2 * ahead), 0.1 * np.abs(x) + 0.4)
    road = np.abs(y) < _KERB
    grey = np.where(road, 0.27, 0.5) + 0.1 * (draw(count) - 0.5)
    marked = (np.abs(y) < 0.25) & (x % 6.0 < 3.0) & (size < 0.25)
    colors = np.where(marked, 0.9, grey)[:, None] * np.array([1.0, 0.98, 0.94])
    means = np.stack([x, y, np.where(road, 0.0, 0.12) + 0.02 * (draw(count) - 0.5)], axis=1)
    return means, _quaternions_about(draw, count, 2), _flat_scales(draw, size, 2), _solid_opacities(draw, count), colors


def _facades(draw: Draw, count: int) -> Part:
    """Two rows of houses with windows, and a house at the end of the street."""
    end = draw(count) < 0.08
    ahead, up, side = draw(count), _HEIGHT * draw(count), np.where(draw(count) < 0.5, -1.0, 1.0)
    rough = 0.15 * (draw(count) - 0.5)
    x = np.where(end, _LENGTH + 55.0 + rough, _along(ahead))
    y = np.where(end, 24.0 * ahead - 12.0, side * (_WALL + rough))
    size = _sizes(draw, count, 2 * 165.0 * _HEIGHT) * np.where(end, 1.0, np.sqrt(2 * ahead))
    house = np.floor((np.where(end, y, x) + 20.0) / 11.0)
    window = (np.where(end, y, x) % 2.8 < 1.2) & (up % 3.2 > 1.1) & (up % 3.2 < 2.6) & (size < 0.5)
    tint = np.stack([0.75 - 0.06 * (house % 3), 0.6 + 0.05 * (house % 4), 0.5 + 0.06 * (house % 5)], axis=1)
    colors = np.where(window[:, None], [0.15, 0.2, 0.28], tint) + 0.08 * (draw((count, 1)) - 0.5)
    quats = np.where(end[:, None], _quaternions_about(draw, count, 0), _quaternions_about(draw, count, 1))
    scales = np.where(end[:, None], _flat_scales(draw, size, 0), _flat_scales(draw, size, 1))
    return np.stack([x, y, up], axis=1), quats, scales, _solid_opacities(draw, count), colors


def _foliage(draw: Draw, count: int) -> Part:
    """Tree crowns: Gaussians of any orientation in balls along both pavements; a tenth of them form the trunks."""
    tree = np.floor(26.0 * draw(count))
    x, y = 6.0 + 7.5 * np.floor(tree / 2), np.where(tree % 2 == 0, -1.0, 1.0) * (_KERB + 1.3)
    offset = 2.0 * draw((count, 3)) - 1.0
    offset *= (0.35 + 0.65 * draw(count) ** 2 / np.sqrt((offset**2).max(axis=1)))[:, None]
    trunk = draw(count) < 0.06
    crown = np.stack([x, y, np.full(count, 5.2)], axis=1) + offset * [1.7, 1.7, 2.0]
    stem = np.stack([x, y, 3.6 * draw(count)], axis=1) + 0.1 * offset * [1.0, 1.0, 0.0]
    size = _sizes(draw, count, 26 * 120.0)[:, None] * (0.4 + draw((count, 3)))
    green = np.array([0.22, 0.4, 0.12]) * (0.5 + 1.1 * draw((count, 1)))
    colors = np.where(trunk[:, None], [0.3, 0.22, 0.15], green)
    scales = np.where(trunk[:, None], np.minimum(size, 0.12), np.minimum(size, 0.45))
    opacities = np.where(trunk, 0.95, 0.25 + 0.7 * draw(count))
    return np.where(trunk[:, None], stem, crown), _random_quaternions(draw, count), scales, opacities, colors


def _lines(draw: Draw, count: int) -> Part:
    """Lamp posts, and sagging wires between them: needles, upright or along the street."""
    post = draw(count) < 0.4
    side = np.where(draw(count) < 0.5, -1.0, 1.0) * (_KERB + 0.4)
    along = (_LENGTH + 20.0) * draw(count)
    sag = (along % 20.0) / 10.0 - 1.0
    wire = np.stack([along, side + 0.3 * np.floor(3 * draw(count)), 6.9 + 0.5 * sag**2], axis=1)
    upright = np.stack([20.0 * np.floor(along / 20.0), side, 7.4 * draw(count)], axis=1)
    quats = np.zeros((count, 4))
    quats[:, 0], quats[:, 2] = 1.0, np.where(post, 0.0, -0.05 * sag)  # the wire's slope, halved
    length = (0.06 + 400.0 / max(count, 1)) * (0.5 + draw(count))
    thick = np.where(post, 0.03, 0.006)
    scales = np.where(post[:, None], np.stack([thick, thick, length]).T, np.stack([length, thick, thick]).T)
    colors = np.where(post[:, None], [0.42, 0.44, 0.45], [0.08, 0.08, 0.09]) + 0.03 * draw((count, 1))
    return np.where(post[:, None], upright, wire), quats, scales, np.full(count, 0.98), colors


def _cars(draw: Draw, count: int) -> Part:
    """Parked cars of two boxes each; the upper one is glass."""
    car = np.floor(24.0 * draw(count))
    x, y = 9.0 + 7.0 * np.floor(car / 2) + 1.5 * (car % 3), np.where(car % 2 == 0, -1.0, 1.0) * (_KERB - 1.3)
    upper = draw(count) < 0.35
    face = np.floor(3.0 * draw(count)).astype(np.int64)
    place = 2.0 * draw((count, 3)) - 1.0
    place[np.arange(count), face] = np.where(draw(count) < 0.5, -1.0, 1.0)
    half = np.where(upper[:, None], [1.15, 0.75, 0.3], [2.2, 0.88, 0.35])
    centre = np.stack([x, y, np.where(upper, 1.2, 0.6)], axis=1)
    size = _sizes(draw, count, 24 * 30.0)[:, None] * np.ones(3)
    size = np.minimum(size, 0.3)
    size[np.arange(count), face] = 0.015
    paint = np.stack([(car * 5 % 7) / 7, (car * 3 % 5) / 6, (car * 2 % 9) / 9], axis=1) * 0.7 + 0.2
    colors = np.where(upper[:, None], 0.35 * paint + 0.08, paint) + 0.06 * (draw((count, 1)) - 0.5)
    quats = np.zeros((count, 4))
    quats[:, 0] = 1.0
    return centre + place * half, quats, size, _solid_opacities(draw, count), colors


def _sky(draw: Draw, count: int) -> Part:
    """A hemisphere of large Gaussians, 150 to 1000 m away: blue with clouds."""
    way = np.stack([2 * draw(count) - 1, 2 * draw(count) - 1, draw(count)], axis=1)
    way /= np.sqrt(way[:, 0] ** 2 + way[:, 1] ** 2 + way[:, 2] ** 2)[:, None]
    reach = 150.0 + 850.0 * draw(count)
    size = (reach * (0.012 + 4.0 / np.sqrt(max(count, 1))))[:, None] * (0.5 + draw((count, 3)))
    high = way[:, 2:]
    cloud = (draw((count, 1)) < 0.25) * (0.5 + 0.5 * draw((count, 1)))
    blue = np.array([0.75, 0.85, 0.95]) * (1 - high) + np.array([0.3, 0.5, 0.85]) * high
    return (
        way * reach[:, None],
        _random_quaternions(draw, count),
        size,
        _solid_opacities(draw, count),
        blue * (1 - cloud) + 0.95 * cloud,
    )


def _along(ahead: Float64) -> Float64:
    """Distances along the street (N,) from uniform numbers, denser near the camera; some are behind it."""
    return (_LENGTH + 60.0) * ahead * ahead - 5.0


def _sizes(draw: Draw, count: int, area: float) -> Float64:
    """Standard deviations (N,) over a surface: most are fine, a few broad; together they cover it about eight times."""
    size = 0.19 / (1.0 - 0.95 * draw(count))
    return size * np.sqrt(area / max(count, 1))


def _flat_scales(draw: Draw, size: Float64, axis: int) -> Float64:
    """Scales (N, 3) that are thin along one axis and up to twice as long as wide across it."""
    scales = size[:, None] * (0.6 + 0.8 * draw((len(size), 3)))
    scales[:, axis] = 0.01
    return scales


def _solid_opacities(draw: Draw, count: int) -> Float64:
    """Opacities (N,) as of trained surfaces: mostly high."""
    soft = draw(count)
    return 0.99 - 0.7 * soft * soft * soft  # not a power: the library's differs between machines


def _quaternions_about(draw: Draw, count: int, axis: int) -> Float64:
    """Quaternions (N, 4) about one axis."""
    quats = np.zeros((count, 4))
    quats[:, 0], quats[:, 1 + axis] = 1.0, 2.0 * draw(count) - 1.0
    return quats


def _random_quaternions(draw: Draw, count: int) -> Float64:
    return 2.0 * draw((count, 4)) - 1.0


def _volume(name: str, count: int, axes: Float64, seed: int) -> Splats:
    """Gaussians of one shape, uniform in the view frustum; their overlap grows slowly with their number."""
    draw = np.random.Generator(np.random.PCG64(seed)).random
    focal, near, far = (0.8, 0.8 * 16 / 9), 2.0, 12.0
    ahead = _cube_root(near**3 + (far**3 - near**3) * draw(count))
    left = 1.1 * (draw(count) - 0.5) / focal[0] * ahead
    up = 1.1 * (draw(count) - 0.5) / focal[1] * ahead
    viewmat = _viewmat(np.zeros(3), 1.0 / 64)
    sine, cosine = viewmat[0, 0], viewmat[2, 0]
    means = np.stack([cosine * ahead - sine * left, sine * ahead + cosine * left, up], axis=1)
    size = 0.055 / _cube_root(np.array([count / 1e5]))
    scales = size * axes * (0.5 + draw((count, 1 if axes[0] > axes[1] else 3)))
    return _splats(
        name, means, 2 * draw((count, 4)) - 1, scales, 0.02 + 0.8 * draw(count), draw((count, 3)), viewmat, focal
    )


def _cube_root(values: Float64) -> Float64:
    """Cube root by Newton's steps: the library's differs between machines in its last bit."""
    root = 1.0 + values / 3.0
    for _ in range(60):
        root = root - (root - values / (root * root)) / 3.0
    return root


def _viewmat(position: Float64, half_tangent: float) -> Float64:
    """(4, 4) of a level camera that looks forwards and slightly to the left."""
    cosine = (1 - half_tangent**2) / (1 + half_tangent**2)
    sine = 2 * half_tangent / (1 + half_tangent**2)
    viewmat = np.eye(4)
    viewmat[:3, :3] = _FORWARD @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    viewmat[:3, 3] = -viewmat[:3, :3] @ position
    return viewmat


def _splats(
    name: str,
    means: AnyArray,
    quats: AnyArray,
    scales: AnyArray,
    opacities: AnyArray,
    colors: AnyArray,
    viewmat: Float64,
    focal: tuple[float, float],
) -> Splats:
    """Round to float32; colours are clipped to 0..1."""
    colors = np.clip(colors, 0.0, 1.0)
    means, quats, scales, opacities, colors = (
        np.ascontiguousarray(array, dtype=np.float32) for array in (means, quats, scales, opacities, colors)
    )
    return Splats(name, means, quats, scales, opacities, colors, viewmat, focal)
