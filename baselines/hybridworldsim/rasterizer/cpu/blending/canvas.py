"""A picture in the making: tiles of 16 x 16 pixels, each 16 blocks of 4 x 4, a block's pixels side by side."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.memory import filled, room
from hybridworldsim.kernels.threads import in_parallel
from hybridworldsim.kernels.vectors import by_pixel, load, store, store_threes
from mirror.arrays import Bool, Float32, Int32

TILE_PX: Final = 16
PIXELS: Final = TILE_PX * TILE_PX
LANES: Final = 16
BLOCKS: Final = 16


class Canvas(NamedTuple):
    """A picture as T tiles, row by row.

    Attributes:
        width: of the picture, pixels.
        height: of the picture.
        tiles_x: columns of tiles.
        tiles_y: rows of them.
        channels: of the colours.
        light: (T * 256,) what is left of it; negative where a pixel is done.
        colours: (T * channels * 256,) blended so far, a tile channel by channel.
        last: (T * 256,) the number in its tile of a pixel's hindmost Gaussian; -1 if it has none.
        passed: (T,) how many Gaussians of each tile there were.
        alive: (T,) whether not all of a tile's pixels are done.
    """

    width: int
    height: int
    tiles_x: int
    tiles_y: int
    channels: int
    light: Float32
    colours: Float32
    last: Int32
    passed: Int32
    alive: Bool

    def picture(self, channels: int) -> tuple[Float32, Float32]:
        """The first channels (H, W, channels), and alpha (H, W)."""
        flat, alpha = room(self.height * self.width * channels), room(self.height * self.width)
        image, alpha = flat.reshape(self.height, self.width, channels), alpha.reshape(self.height, self.width)

        def write(row: int) -> None:
            _from_blocks(row, self.colours, self.light, self.channels, self.tiles_x, image, flat, alpha)

        in_parallel(write, self.tiles_y)
        return image, alpha

    def gradients(self, by_image: Float32, by_alpha: Float32) -> tuple[Float32, Float32, Float32]:
        """Gradients as the canvas lies.

        Args:
            by_image: (H, W, D).
            by_alpha: (H, W).

        Returns:
            To the colours (T * channels * 256,); the light that is left (T * 256,); minus that times the gradient to
            alpha (T * 256,).
        """
        to_colours = filled(len(self.colours), 0.0)
        light, behind = room(len(self.light)), room(len(self.light))

        def write(row: int) -> None:
            _into_blocks(row, by_image, by_alpha, self.light, self.channels, self.tiles_x, to_colours, light, behind)

        in_parallel(write, self.tiles_y)
        return to_colours, light, behind


def blank(width: int, height: int, channels: int) -> Canvas:
    """Nothing blended yet; what lies beyond the picture is done."""
    tiles_x, tiles_y = -(-width // TILE_PX), -(-height // TILE_PX)
    count = tiles_x * tiles_y
    light = filled(count * PIXELS, 1.0)
    blocks = light.reshape(tiles_y, tiles_x, 4, 4, 4, 4)
    below, beside = height - (tiles_y - 1) * TILE_PX, width - (tiles_x - 1) * TILE_PX
    for pixel in range(below, TILE_PX):
        blocks[-1, :, pixel // 4, :, pixel % 4] = -1.0
    for pixel in range(beside, TILE_PX):
        blocks[:, -1, :, pixel // 4, :, pixel % 4] = -1.0
    return Canvas(
        width,
        height,
        tiles_x,
        tiles_y,
        channels,
        light,
        filled(count * PIXELS * channels, 0.0),
        filled(count * PIXELS, -1, np.int32),
        np.zeros(count, np.int32),
        np.ones(count, np.bool_),
    )


@kernel()
def _from_blocks(
    tile_y: int,
    colours: Float32,
    light: Float32,
    channels: int,
    tiles_x: int,
    image: Float32,
    flat: Float32,
    alpha: Float32,
) -> None:
    """Write a row of tiles into a picture."""
    height, width, wide = image.shape
    for tile_x in range(tiles_x):
        tile = tile_y * tiles_x + tile_x
        for block in range(BLOCKS):
            y0, x0 = tile_y * TILE_PX + block // 4 * 4, tile_x * TILE_PX + block % 4 * 4
            lit, coloured = tile * PIXELS + block * LANES, tile * channels * PIXELS + block * LANES
            whole = y0 + 4 <= height and x0 + 4 <= width and 3 <= wide <= 4
            if whole:
                rows = by_pixel(
                    (
                        load(colours, coloured),
                        load(colours, coloured + PIXELS),
                        load(colours, coloured + 2 * PIXELS),
                        load(colours, coloured + 3 * PIXELS),
                    )
                )
                to, step = (y0 * width + x0) * wide, width * wide
                if wide == 4:
                    store(flat, to, rows[0])
                    store(flat, to + step, rows[1])
                    store(flat, to + 2 * step, rows[2])
                    store(flat, to + 3 * step, rows[3])
                else:
                    store_threes(flat, to, rows[0])
                    store_threes(flat, to + step, rows[1])
                    store_threes(flat, to + 2 * step, rows[2])
                    store_threes(flat, to + 3 * step, rows[3])
            for down in range(min(4, height - y0)):
                for across in range(min(4, width - x0)):
                    lane = down * 4 + across
                    y, x = np.uint64(y0 + down), np.uint64(x0 + across)
                    alpha[y, x] = np.float32(1.0) - abs(light[np.uint64(lit + lane)])
                    if whole:
                        continue
                    for channel in range(wide):
                        image[y, x, np.uint64(channel)] = colours[np.uint64(coloured + channel * PIXELS + lane)]


@kernel()
def _into_blocks(
    tile_y: int,
    by_image: Float32,
    by_alpha: Float32,
    left: Float32,
    channels: int,
    tiles_x: int,
    to_colours: Float32,
    light: Float32,
    behind: Float32,
) -> None:
    """Write a row of tiles of gradients into blocks."""
    height, width, wide = by_image.shape
    for tile_x in range(tiles_x):
        tile = tile_y * tiles_x + tile_x
        for block in range(BLOCKS):
            y0, x0 = tile_y * TILE_PX + block // 4 * 4, tile_x * TILE_PX + block % 4 * 4
            lit, coloured = tile * PIXELS + block * LANES, tile * channels * PIXELS + block * LANES
            for lane in range(LANES):
                at = np.uint64(lit + lane)
                light[at], behind[at] = abs(left[at]), np.float32(0.0)
                y, x = np.uint64(y0 + lane // 4), np.uint64(x0 + lane % 4)
                if y < np.uint64(height) and x < np.uint64(width):
                    behind[at] = -light[at] * by_alpha[y, x]
                    for channel in range(wide):
                        place = np.uint64(coloured + channel * PIXELS + lane)
                        to_colours[place] = by_image[y, x, np.uint64(channel)]
