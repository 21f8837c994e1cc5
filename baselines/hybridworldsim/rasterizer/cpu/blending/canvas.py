"""The image during blending: tiles of 16 x 16 pixels in blocks of 4 x 4; the pixels of a block are contiguous.

What is kept of a pixel is written and read only in tiles that a Gaussian reaches: most of the time of an image with few
Gaussians would be that of its memory.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.memory import empty_aligned
from hybridworldsim.kernels.vectors import (
    abs_,
    broadcast,
    fence,
    load,
    store,
    store_nontemporal,
    store_rgb,
    transpose_channels,
)
from mirror.arrays import Bool, Float32, Int32

TILE_PX: Final = 16
PIXELS: Final = TILE_PX * TILE_PX
LANES: Final = 16
BLOCKS: Final = 16
_LARGE: Final = 1 << 20
"""Numbers of an image that is written past the caches, which it would empty: 4 MB."""


class Canvas(NamedTuple):
    """An image of T tiles, row by row.

    `transmittance`, `colours` and `last` of a tile are undefined until a Gaussian reaches the tile.

    Attributes:
        width: width of the image, pixels.
        height: height of the image, pixels.
        tiles_x: columns of tiles.
        tiles_y: rows of tiles.
        channels: number of colour channels.
        transmittance: (T * 256,) remaining transmittance; negative if the pixel is done.
        colours: (T * channels * 256,) blended colours, channel by channel in each tile.
        last: (T * 256,) index in its tile of the last Gaussian of a pixel; -1 without Gaussians.
        counts_before: (T,) number of Gaussians of each tile in earlier slices; after the last slice, in all.
        alive: (T,) whether at least one pixel of a tile is not done.
    """

    width: int
    height: int
    tiles_x: int
    tiles_y: int
    channels: int
    transmittance: Float32
    colours: Float32
    last: Int32
    counts_before: Int32
    alive: Bool

    def make_image(self, channels: int) -> tuple[Float32, Float32, Callable[[int], None]]:
        """Make an image (H, W, channels) of the first channels, its alpha (H, W), and the function that writes them.

        The function writes one row of tiles. It is called where the row was blended last, while the row is cached.
        """
        flat, alpha = empty_aligned(self.height * self.width * channels), empty_aligned(self.height * self.width)
        image, alpha = flat.reshape(self.height, self.width, channels), alpha.reshape(self.height, self.width)

        def write(row: int) -> None:
            _blocks_to_image(
                row, self.colours, self.transmittance, self.counts_before, self.channels, self.tiles_x, image, flat,
                alpha,
            )  # fmt: skip

        return image, alpha, write

    def make_gradients(
        self, grad_image: Float32, grad_alpha: Float32
    ) -> tuple[Float32, Float32, Float32, Callable[[int], None]]:
        """Make gradients in block layout, and the function that converts one row of tiles to them.

        Args:
            grad_image: (H, W, D) gradient to the image.
            grad_alpha: (H, W) gradient to alpha.

        Returns:
            The gradient to the colours (T * channels * 256,); the remaining transmittance (T * 256,); minus the
            transmittance times the gradient to alpha (T * 256,); and the function. Tiles without Gaussians stay
            undefined.
        """
        grad_colours, flat = empty_aligned(len(self.colours)), grad_image.reshape(-1)
        transmittance, background_sum = empty_aligned(len(self.transmittance)), empty_aligned(len(self.transmittance))

        def write(row: int) -> None:
            _gradients_to_blocks(
                row, grad_image, flat, grad_alpha, self.transmittance, self.counts_before, self.channels, self.tiles_x,
                grad_colours, transmittance, background_sum,
            )  # fmt: skip

        return grad_colours, transmittance, background_sum, write


def make_canvas(width: int, height: int, channels: int) -> Canvas:
    """Make an empty canvas."""
    tiles_x, tiles_y = -(-width // TILE_PX), -(-height // TILE_PX)
    count = tiles_x * tiles_y
    return Canvas(
        width,
        height,
        tiles_x,
        tiles_y,
        channels,
        empty_aligned(count * PIXELS),
        empty_aligned(count * PIXELS * channels),
        empty_aligned(count * PIXELS, np.int32),
        np.zeros(count, np.int32),
        np.ones(count, np.bool_),
    )


@kernel(inline="always")
def empty_tile(
    tile: int,
    transmittance: Float32,
    colours: Float32,
    last: Int32,
    channels: int,
    tiles_x: int,
    width: int,
    height: int,
) -> None:
    """Write a tile without Gaussians; pixels outside the image are marked as done."""
    one, zero = np.float32(1.0), broadcast(np.float32(0.0))
    columns, rows = width - (tile % tiles_x) * TILE_PX, height - (tile // tiles_x) * TILE_PX
    for block in range(BLOCKS):
        at = tile * PIXELS + block * LANES
        for lane in range(LANES):
            inside = block // 4 * 4 + lane // 4 < rows and block % 4 * 4 + lane % 4 < columns
            transmittance[np.uint64(at + lane)] = one if inside else -one
            last[np.uint64(at + lane)] = -1
    for start in range(tile * PIXELS * channels, (tile + 1) * PIXELS * channels, LANES):
        store(colours, start, zero)


@kernel()
def _blocks_to_image(
    tile_y: int,
    colours: Float32,
    transmittance: Float32,
    counts: Int32,
    channels: int,
    tiles_x: int,
    image: Float32,
    flat: Float32,
    alpha: Float32,
) -> None:
    """Copy a row of tiles to the image; tiles without Gaussians are black."""
    height, width, image_channels = image.shape
    past_caches = image_channels == 4 and width % 4 == 0 and image.size >= _LARGE
    for tile_x in range(tiles_x):
        tile = tile_y * tiles_x + tile_x
        if counts[tile] == 0:
            from_x, to_x = np.uint64(tile_x * TILE_PX), np.uint64(min((tile_x + 1) * TILE_PX, width))
            for row in range(tile_y * TILE_PX, min((tile_y + 1) * TILE_PX, height)):
                start = np.uint64(row) * np.uint64(width)
                for place in range(
                    (start + from_x) * np.uint64(image_channels), (start + to_x) * np.uint64(image_channels)
                ):
                    flat[place] = np.float32(0.0)
                for column in range(from_x, to_x):
                    alpha[np.uint64(row), column] = np.float32(0.0)
            continue
        for block in range(BLOCKS):
            y0, x0 = tile_y * TILE_PX + block // 4 * 4, tile_x * TILE_PX + block % 4 * 4
            pixel_start, color_start = tile * PIXELS + block * LANES, tile * channels * PIXELS + block * LANES
            whole = y0 + 4 <= height and x0 + 4 <= width and 3 <= image_channels <= 4
            if whole:
                _write_alpha(alpha, y0, x0, transmittance, pixel_start)
                rows = transpose_channels(
                    (
                        load(colours, color_start),
                        load(colours, color_start + PIXELS),
                        load(colours, color_start + 2 * PIXELS),
                        load(colours, color_start + 3 * PIXELS),
                    )
                )
                to, step = (y0 * width + x0) * image_channels, width * image_channels
                if past_caches:
                    store_nontemporal(flat, to, rows[0])
                    store_nontemporal(flat, to + step, rows[1])
                    store_nontemporal(flat, to + 2 * step, rows[2])
                    store_nontemporal(flat, to + 3 * step, rows[3])
                elif image_channels == 4:
                    store(flat, to, rows[0])
                    store(flat, to + step, rows[1])
                    store(flat, to + 2 * step, rows[2])
                    store(flat, to + 3 * step, rows[3])
                else:
                    store_rgb(flat, to, rows[0])
                    store_rgb(flat, to + step, rows[1])
                    store_rgb(flat, to + 2 * step, rows[2])
                    store_rgb(flat, to + 3 * step, rows[3])
                continue
            for down in range(min(4, height - y0)):
                for across in range(min(4, width - x0)):
                    lane = down * 4 + across
                    y, x = np.uint64(y0 + down), np.uint64(x0 + across)
                    alpha[y, x] = np.float32(1.0) - abs(transmittance[np.uint64(pixel_start + lane)])
                    for channel in range(image_channels):
                        image[y, x, np.uint64(channel)] = colours[np.uint64(color_start + channel * PIXELS + lane)]
    fence()


@kernel(inline="always")
def _write_alpha(alpha: Float32, y0: int, x0: int, transmittance: Float32, start: int) -> None:
    """Write the alpha of a whole block; all numbers of a row are read before one is written, for vectors of four."""
    one, x = np.float32(1.0), np.uint64(x0)
    for down in range(4):
        at, y = np.uint64(start + 4 * down), np.uint64(y0 + down)
        a, b = transmittance[at], transmittance[at + np.uint64(1)]
        c, d = transmittance[at + np.uint64(2)], transmittance[at + np.uint64(3)]
        alpha[y, x], alpha[y, x + np.uint64(1)] = one - abs(a), one - abs(b)
        alpha[y, x + np.uint64(2)], alpha[y, x + np.uint64(3)] = one - abs(c), one - abs(d)


@kernel(inline="always")
def _read_alpha(grad_alpha: Float32, y0: int, x0: int, sums: Float32, start: int) -> None:
    """Read the gradients to the alpha of a whole block."""
    x = np.uint64(x0)
    for down in range(4):
        at, y = np.uint64(start + 4 * down), np.uint64(y0 + down)
        a, b = grad_alpha[y, x], grad_alpha[y, x + np.uint64(1)]
        c, d = grad_alpha[y, x + np.uint64(2)], grad_alpha[y, x + np.uint64(3)]
        sums[at], sums[at + np.uint64(1)] = a, b
        sums[at + np.uint64(2)], sums[at + np.uint64(3)] = c, d


@kernel()
def _gradients_to_blocks(
    tile_y: int,
    grad_image: Float32,
    flat: Float32,
    grad_alpha: Float32,
    remaining: Float32,
    counts: Int32,
    channels: int,
    tiles_x: int,
    grad_colours: Float32,
    transmittance: Float32,
    background_sum: Float32,
) -> None:
    """Copy the gradients of a row of tiles to blocks, of tiles with Gaussians."""
    height, width, image_channels = grad_image.shape
    zero = broadcast(np.float32(0.0))
    for tile_x in range(tiles_x):
        tile = tile_y * tiles_x + tile_x
        if counts[tile] == 0:
            continue
        for block in range(BLOCKS):
            y0, x0 = tile_y * TILE_PX + block // 4 * 4, tile_x * TILE_PX + block % 4 * 4
            pixel_start, color_start = tile * PIXELS + block * LANES, tile * channels * PIXELS + block * LANES
            if y0 + 4 <= height and x0 + 4 <= width and image_channels == 4:
                start, step = (y0 * width + x0) * 4, width * 4
                # Three turns of channels, rows and columns are none, so that two undo `_blocks_to_image`'s.
                planes = transpose_channels(
                    transpose_channels(
                        (
                            load(flat, start),
                            load(flat, start + step),
                            load(flat, start + 2 * step),
                            load(flat, start + 3 * step),
                        )
                    )
                )
                store(grad_colours, color_start, planes[0])
                store(grad_colours, color_start + PIXELS, planes[1])
                store(grad_colours, color_start + 2 * PIXELS, planes[2])
                store(grad_colours, color_start + 3 * PIXELS, planes[3])
                _read_alpha(grad_alpha, y0, x0, background_sum, pixel_start)
                left = abs_(load(remaining, pixel_start))
                store(transmittance, pixel_start, left)
                store(background_sum, pixel_start, (zero - left) * load(background_sum, pixel_start))
                continue
            for channel in range(channels):
                store(grad_colours, color_start + channel * PIXELS, zero)
            for lane in range(LANES):
                at = np.uint64(pixel_start + lane)
                transmittance[at], background_sum[at] = abs(remaining[at]), np.float32(0.0)
                y, x = np.uint64(y0 + lane // 4), np.uint64(x0 + lane % 4)
                if y < np.uint64(height) and x < np.uint64(width):
                    background_sum[at] = -transmittance[at] * grad_alpha[y, x]
                    for channel in range(image_channels):
                        place = np.uint64(color_start + channel * PIXELS + lane)
                        grad_colours[place] = grad_image[y, x, np.uint64(channel)]
