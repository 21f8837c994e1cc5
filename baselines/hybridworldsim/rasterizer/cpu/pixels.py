"""Between pictures and tiles of blocks: a tile is 16 blocks of 4 x 4 pixels, each block's pixels lie together."""

from __future__ import annotations

import numpy as np

from hybridworldsim.rasterizer.cpu.blending import BLOCKS, LANES, PIXELS
from hybridworldsim.rasterizer.cpu.kernels import kernel
from hybridworldsim.rasterizer.cpu.splats import TILE_PX
from mirror.arrays import Float32, Int32, Int64


@kernel()
def from_blocks(
    tile_y: int,
    colours: Float32,
    light: Float32,
    hindmost: Int32,
    begins: Int64,
    ids: Int32,
    channels: int,
    tiles_x: int,
    image: Float32,
    alpha: Float32,
    last: Int32,
) -> None:
    """Write a row of tiles into a picture.

    Args:
        tile_y: number of the row.
        colours: (T * channels * 256,).
        light: (T * 256,) that is left, or its negative.
        hindmost: (T * 256,) the number in its tile of each pixel's hindmost Gaussian, or -1.
        begins: (T + 1,) where the places of each tile begin.
        ids: the Gaussian at each place.
        channels: of the colours.
        tiles_x: columns of tiles.
        image: (H, W, D) written.
        alpha: (H, W) written.
        last: (H, W) written: the hindmost Gaussian, or -1.
    """
    height, width, wide = image.shape
    for down in range(min(TILE_PX, height - tile_y * TILE_PX)):
        y = tile_y * TILE_PX + down
        for x in range(width):
            across = x % TILE_PX
            tile = tile_y * tiles_x + x // TILE_PX
            lane = (down // 4 * 4 + across // 4) * LANES + down % 4 * 4 + across % 4
            number = hindmost[tile * PIXELS + lane]
            last[y, x] = ids[begins[tile] + number] if number >= 0 else -1
            alpha[y, x] = np.float32(1.0) - abs(light[tile * PIXELS + lane])
            for channel in range(wide):
                image[y, x, channel] = colours[(tile * channels + channel) * PIXELS + lane]


@kernel()
def into_blocks(
    tile_y: int,
    by_image: Float32,
    by_alpha: Float32,
    left: Float32,
    channels: int,
    tiles_x: int,
    gradient: Float32,
    light: Float32,
    behind: Float32,
) -> None:
    """Write a row of tiles of gradients into blocks.

    Args:
        tile_y: number of the row.
        by_image: (H, W, D).
        by_alpha: (H, W).
        left: (T * 256,) light that is left, or its negative.
        channels: of the colours.
        tiles_x: columns of tiles.
        gradient: (T * channels * 256,) written where the picture is.
        light: (T * 256,) written: what is left.
        behind: (T * 256,) written: minus that times the gradient to alpha.
    """
    height, width, wide = by_image.shape
    for tile in range(tile_y * tiles_x, (tile_y + 1) * tiles_x):
        for block in range(BLOCKS):
            for lane in range(LANES):
                at = tile * PIXELS + block * LANES + lane
                y = tile_y * TILE_PX + block // 4 * 4 + lane // 4
                x = tile % tiles_x * TILE_PX + block % 4 * 4 + lane % 4
                light[at], behind[at] = abs(left[at]), np.float32(0.0)
                if y < height and x < width:
                    behind[at] = -light[at] * by_alpha[y, x]
                    for channel in range(wide):
                        gradient[(tile * channels + channel) * PIXELS + block * LANES + lane] = by_image[y, x, channel]
