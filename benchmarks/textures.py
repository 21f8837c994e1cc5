"""Measures time and error of texture means over pixels, and the time of drawing the atlas.

``python -m benchmarks textures`` reads grains and images over pixels 0.7 to 12 texels wide, at random rotations, up to
eight times as long as wide. The error is the root mean square difference to 40 x 40 bilinear samples in float64, for
values up to 1; in an image it is multiplied by the reflectance (asphalt 0.1, grass 0.15, brick 0.3). Rows:
``name, size, ms, error, peer``; ms are for a million pixels, so that the same number is nanoseconds for a pixel. The
peer takes 8 x 8 bilinear samples of the finest level.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Final

import numpy as np
from numba import njit

from benchmarks.report import Peer, Row, best_ms, report
from mirror.arrays import Float32, Float64, Int64, UInt8
from mirror.synth.textures import atlas as building
from mirror.synth.textures.atlas import atlas
from mirror.synth.textures.catalogue import BILLBOARDS, PLATES, SHOP_SIGNS, TRAFFIC_SIGNS, Grain
from mirror.synth.textures.sampling import grain_at, image_at

RATIOS: Final = (1.0, 2.0, 4.0, 8.0)
COUNT: Final = 20_000
CHECKED: Final = 1_500
EXACT_SAMPLES: Final = 40
GRAINS: Final = (Grain.ASPHALT, Grain.PAVING, Grain.BRICK, Grain.GRASS, Grain.PLASTER, Grain.STAINS)
IMAGES: Final = {
    "shop sign": SHOP_SIGNS[1],
    "billboard": BILLBOARDS[3],
    "traffic sign": TRAFFIC_SIGNS[0],
    "plate": PLATES[7],
}


@njit(cache=True, nogil=True, error_model="numpy")
def _grains(grains: Float32, index: Float64, grain: int, at: Float64, out: Float64) -> None:
    for k in range(len(at)):
        out[k, 0] = grain_at(
            grains, index, grain, at[k, 0], at[k, 1], at[k, 2], at[k, 3], at[k, 4], at[k, 5]
        )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _images(images: UInt8, index: Int64, image: int, at: Float64, out: Float64) -> None:
    for k in range(len(at)):
        out[k, 0], out[k, 1], out[k, 2] = image_at(
            images, index, image, at[k, 0], at[k, 1], at[k, 2], at[k, 3], at[k, 4], at[k, 5]
        )


@njit(cache=True, nogil=True, error_model="numpy")
def _sample_means(texels: Float64, at: Float64, count: int, out: Float64) -> None:
    """Means of count x count bilinear samples; places and sides are in texels, and the texture repeats."""
    height, width, channels = texels.shape
    for k in range(len(at)):
        for n in range(channels):
            out[k, n] = 0.0
        for i in range(count):
            for j in range(count):
                a, b = (i + 0.5) / count - 0.5, (j + 0.5) / count - 0.5
                x = at[k, 0] + a * at[k, 2] + b * at[k, 4] - 0.5
                y = at[k, 1] + a * at[k, 3] + b * at[k, 5] - 0.5
                left, low = int(np.floor(x)), int(np.floor(y))
                u, v = x - left, y - low
                c0, c1, r0, r1 = left % width, (left + 1) % width, low % height, (low + 1) % height
                for n in range(channels):
                    under = texels[r0, c0, n] * (1 - u) + texels[r0, c1, n] * u
                    over = texels[r1, c0, n] * (1 - u) + texels[r1, c1, n] * u
                    out[k, n] += (under * (1 - v) + over * v) / (count * count)


def _pixels(count: int, ratio: float, max_width: float, size: tuple[int, int], seed: int) -> Float64:
    """Pixels (N, 6) within a texture, in texels, sorted by size, because neighbouring pixels have similar sizes."""
    rng = np.random.default_rng(seed)
    width = np.sort(np.exp(rng.uniform(np.log(0.7), np.log(max_width), count)))[:, None]
    turn, lean = rng.uniform(0.0, 2.0 * np.pi, (count, 1)), rng.uniform(-0.3, 0.3, (count, 1))
    along, across = np.c_[np.cos(turn), np.sin(turn)], np.c_[-np.sin(turn), np.cos(turn)]
    sides = np.c_[ratio * width * along, width * (across + lean * along)]
    reach = 0.5 * (np.abs(sides[:, :2]) + np.abs(sides[:, 2:]))
    return np.c_[reach + rng.uniform(0.0, 1.0, (count, 2)) * (np.array(size) - 2.0 * reach), sides]


def _grain_rows() -> Iterator[Row]:
    whole_atlas = atlas()
    for grain in GRAINS:
        first, log, scale = whole_atlas.grain_index[grain, :3]
        size = 1 << int(log)
        texels = whole_atlas.grains[int(first) : int(first) + size * size].reshape(size, size, 1).astype(np.float64)
        for ratio in RATIOS:
            at, values = _pixels(COUNT, ratio, 12.0, (size, size), int(grain)), np.zeros((COUNT, 1))
            call = partial(_grains, whole_atlas.grains, whole_atlas.grain_index, int(grain), at / scale, values)
            yield _row(f"{grain.name.lower()} 1:{ratio:.0f}", call, texels, at, values)


def _image_rows() -> Iterator[Row]:
    whole_atlas = atlas()
    for name, number in IMAGES.items():
        width, height, _, first = whole_atlas.image_index[number, :4]
        texels = (whole_atlas.images[first : first + width * height].reshape(height, width, 3) / 255.0) ** 2
        for ratio in RATIOS:
            at = _pixels(COUNT, ratio, min(12.0, height / (3.0 * ratio)), (width, height), number)
            values = np.zeros((COUNT, 3))
            shares = at / np.tile((width, -height), 3) + np.array([0, 1, 0, 0, 0, 0])
            call = partial(_images, whole_atlas.images, whole_atlas.image_index, number, shares, values)
            yield _row(f"{name} 1:{ratio:.0f}", call, texels, at, values)


def _row(name: str, call: Callable[[], None], texels: Float64, at: Float64, values: Float64) -> Row:
    ms = best_ms(call, 7)
    every_nth = slice(None, None, len(at) // CHECKED)
    expected, sampled = np.zeros_like(values[every_nth]), np.zeros_like(values[every_nth])
    _sample_means(texels, at[every_nth], EXACT_SAMPLES, expected)
    peer_ms = best_ms(lambda: _sample_means(texels, at[every_nth], 8, sampled), 1)
    error, peer_error = (float(np.sqrt(np.mean((one - expected) ** 2))) for one in (values[every_nth], sampled))
    per_million, per_million_sampled = 1e6 / len(at), 1e6 / len(sampled)
    peer = Peer("64 samples", peer_ms * per_million_sampled, peer_error)
    return Row(name, "10^6 pixels", ms * per_million, error, (peer,), "rms")


def _atlas_rows() -> Iterator[Row]:
    atlas()
    start = time.perf_counter()
    whole_atlas = building.build_atlas()
    ms = (time.perf_counter() - start) * 1e3
    size = (whole_atlas.grains.nbytes + whole_atlas.images.nbytes) / 2**20
    yield Row("atlas drawn", f"{len(whole_atlas.image_index)} images, {len(Grain)} grains, {size:.0f} MB", ms)


def main(argv: Sequence[str]) -> int:
    """Print time and error of drawing and reading textures."""
    groups = {"grains": _grain_rows(), "images": _image_rows(), "atlas": _atlas_rows()}
    return report("textures", groups, errors="root mean square error, of 1")
