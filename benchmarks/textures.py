"""Means of textures over pixels: time and error, against means of 64 samples; and how long the atlas takes.

``python -m benchmarks textures`` reads grains and images over pixels of 0.7 to 12 texels' width, turned at random, up
to eight times as long as wide. The error is the root mean square against 40 x 40 bilinear samples in float64, of 1:
what it does to an image is that times the reflectance (asphalt 0.1, grass 0.15, brick 0.3).
Rows: ``name, size, ms, error, peer``; ms are for a million pixels, so that the same number is nanoseconds a pixel.
The peer takes 8 x 8 bilinear samples of the finest level.
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
JUDGED: Final = 1_500
EXACT: Final = 40
GRAINS: Final = (Grain.ASPHALT, Grain.PAVING, Grain.BRICK, Grain.GRASS, Grain.PLASTER, Grain.STAINS)
PICTURES: Final = {
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
def _sampled(texels: Float64, at: Float64, count: int, out: Float64) -> None:
    """Means of count x count bilinear samples; places and sides in texels, beyond the edge the other edge goes on."""
    high, wide, channels = texels.shape
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
                c0, c1, r0, r1 = left % wide, (left + 1) % wide, low % high, (low + 1) % high
                for n in range(channels):
                    under = texels[r0, c0, n] * (1 - u) + texels[r0, c1, n] * u
                    over = texels[r1, c0, n] * (1 - u) + texels[r1, c1, n] * u
                    out[k, n] += (under * (1 - v) + over * v) / (count * count)


def _pixels(count: int, ratio: float, most: float, size: tuple[int, int], seed: int) -> Float64:
    """Pixels (N, 6) within a texture, in texels, sorted by size as neighbours are alike."""
    rng = np.random.default_rng(seed)
    wide = np.sort(np.exp(rng.uniform(np.log(0.7), np.log(most), count)))[:, None]
    turn, lean = rng.uniform(0.0, 2.0 * np.pi, (count, 1)), rng.uniform(-0.3, 0.3, (count, 1))
    along, across = np.c_[np.cos(turn), np.sin(turn)], np.c_[-np.sin(turn), np.cos(turn)]
    sides = np.c_[ratio * wide * along, wide * (across + lean * along)]
    reach = 0.5 * (np.abs(sides[:, :2]) + np.abs(sides[:, 2:]))
    return np.c_[reach + rng.uniform(0.0, 1.0, (count, 2)) * (np.array(size) - 2.0 * reach), sides]


def _grain_rows() -> Iterator[Row]:
    full = atlas()
    for grain in GRAINS:
        first, log, scale = full.grain_index[grain, :3]
        size = 1 << int(log)
        texels = full.grains[int(first) : int(first) + size * size].reshape(size, size, 1).astype(np.float64)
        for ratio in RATIOS:
            at, made = _pixels(COUNT, ratio, 12.0, (size, size), int(grain)), np.zeros((COUNT, 1))
            call = partial(_grains, full.grains, full.grain_index, int(grain), at / scale, made)
            yield _row(f"{grain.name.lower()} 1:{ratio:.0f}", call, texels, at, made)


def _picture_rows() -> Iterator[Row]:
    full = atlas()
    for name, number in PICTURES.items():
        wide, high, _, first = full.image_index[number, :4]
        texels = (full.images[first : first + wide * high].reshape(high, wide, 3) / 255.0) ** 2
        for ratio in RATIOS:
            at = _pixels(COUNT, ratio, min(12.0, high / (3.0 * ratio)), (wide, high), number)
            made = np.zeros((COUNT, 3))
            shares = at / np.tile((wide, -high), 3) + np.array([0, 1, 0, 0, 0, 0])
            call = partial(_images, full.images, full.image_index, number, shares, made)
            yield _row(f"{name} 1:{ratio:.0f}", call, texels, at, made)


def _row(name: str, call: Callable[[], None], texels: Float64, at: Float64, made: Float64) -> Row:
    ms = best_ms(call, 7)
    some = slice(None, None, len(at) // JUDGED)
    wanted, sampled = np.zeros_like(made[some]), np.zeros_like(made[some])
    _sampled(texels, at[some], EXACT, wanted)
    peer_ms = best_ms(lambda: _sampled(texels, at[some], 8, sampled), 1)
    error, peer_error = (float(np.sqrt(np.mean((one - wanted) ** 2))) for one in (made[some], sampled))
    million, judged = 1e6 / len(at), 1e6 / len(sampled)
    peer = Peer("64 samples", peer_ms * judged, peer_error)
    return Row(name, "10^6 pixels", ms * million, error, (peer,), "rms")


def _built() -> Iterator[Row]:
    atlas()
    start = time.perf_counter()
    full = building.build_atlas()
    ms = (time.perf_counter() - start) * 1e3
    size = (full.grains.nbytes + full.images.nbytes) / 2**20
    yield Row("atlas drawn", f"{len(full.image_index)} images, {len(Grain)} grains, {size:.0f} MB", ms)


def main(argv: Sequence[str]) -> int:
    """Print what drawing and reading textures costs, and how exact it is."""
    groups = {"grains": _grain_rows(), "pictures": _picture_rows(), "atlas": _built()}
    return report("textures", groups, errors="root mean square error, of 1")
