"""The image during blending: tiles of 16 x 16 pixels in blocks of 4 x 4; the pixels of a block are contiguous."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.memory import empty_aligned, full_aligned
from hybridworldsim.kernels.threads import in_parallel
from hybridworldsim.kernels.vectors import load, store, store_rgb, transpose_channels
from mirror.arrays import Bool, Float32, Int32

TILE_PX: Final = 16
PIXELS: Final = TILE_PX * TILE_PX
LANES: Final = 16
BLOCKS: Final = 16


class Canvas(NamedTuple):
    """An image of T tiles, row by row.

    Attributes:
        width: width of the image, pixels.
        height: height of the image, pixels.
        tiles_x: columns of tiles.
        tiles_y: rows of tiles.
        channels: number of colour channels.
        transmittance: (T * 256,) remaining transmittance; negative if the pixel is done.
        colours: (T * channels * 256,) blended colours, channel by channel in each tile.
        last: (T * 256,) index in its tile of the last Gaussian of a pixel; -1 without Gaussians.
        counts_before: (T,) number of Gaussians of each tile in earlier slices.
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

    def to_image(self, channels: int) -> tuple[Float32, Float32]:
        """Convert to an image with the first channels (H, W, channels), and alpha (H, W)."""
        flat, alpha = empty_aligned(self.height * self.width * channels), empty_aligned(self.height * self.width)
        image, alpha = flat.reshape(self.height, self.width, channels), alpha.reshape(self.height, self.width)

        def write(row: int) -> None:
            _blocks_to_image(row, self.colours, self.transmittance, self.channels, self.tiles_x, image, flat, alpha)

        in_parallel(write, self.tiles_y)
        return image, alpha

    def gradients_to_blocks(self, grad_image: Float32, grad_alpha: Float32) -> tuple[Float32, Float32, Float32]:
        """Convert gradients from image to block layout.

        Args:
            grad_image: (H, W, D) gradient to the image.
            grad_alpha: (H, W) gradient to alpha.

        Returns:
            The gradient to the colours (T * channels * 256,); the remaining transmittance (T * 256,); and minus the
            transmittance times the gradient to alpha (T * 256,).
        """
        grad_colours = full_aligned(len(self.colours), 0.0)
        transmittance, background_sum = empty_aligned(len(self.transmittance)), empty_aligned(len(self.transmittance))

        def write(row: int) -> None:
            _gradients_to_blocks(
                row,
                grad_image,
                grad_alpha,
                self.transmittance,
                self.channels,
                self.tiles_x,
                grad_colours,
                transmittance,
                background_sum,
            )

        in_parallel(write, self.tiles_y)
        return grad_colours, transmittance, background_sum


def make_canvas(width: int, height: int, channels: int) -> Canvas:
    """Make an empty canvas; pixels outside the image are marked as done."""
    tiles_x, tiles_y = -(-width // TILE_PX), -(-height // TILE_PX)
    count = tiles_x * tiles_y
    transmittance = full_aligned(count * PIXELS, 1.0)
    blocks = transmittance.reshape(tiles_y, tiles_x, 4, 4, 4, 4)
    rows_used, columns_used = height - (tiles_y - 1) * TILE_PX, width - (tiles_x - 1) * TILE_PX
    for pixel in range(rows_used, TILE_PX):
        blocks[-1, :, pixel // 4, :, pixel % 4] = -1.0
    for pixel in range(columns_used, TILE_PX):
        blocks[:, -1, :, pixel // 4, :, pixel % 4] = -1.0
    return Canvas(
        width,
        height,
        tiles_x,
        tiles_y,
        channels,
        transmittance,
        full_aligned(count * PIXELS * channels, 0.0),
        full_aligned(count * PIXELS, -1, np.int32),
        np.zeros(count, np.int32),
        np.ones(count, np.bool_),
    )


@kernel()
def _blocks_to_image(
    tile_y: int,
    colours: Float32,
    transmittance: Float32,
    channels: int,
    tiles_x: int,
    image: Float32,
    flat: Float32,
    alpha: Float32,
) -> None:
    """Copy a row of tiles to the image."""
    height, width, image_channels = image.shape
    for tile_x in range(tiles_x):
        tile = tile_y * tiles_x + tile_x
        for block in range(BLOCKS):
            y0, x0 = tile_y * TILE_PX + block // 4 * 4, tile_x * TILE_PX + block % 4 * 4
            pixel_start, color_start = tile * PIXELS + block * LANES, tile * channels * PIXELS + block * LANES
            whole = y0 + 4 <= height and x0 + 4 <= width and 3 <= image_channels <= 4
            if whole:
                rows = transpose_channels(
                    (
                        load(colours, color_start),
                        load(colours, color_start + PIXELS),
                        load(colours, color_start + 2 * PIXELS),
                        load(colours, color_start + 3 * PIXELS),
                    )
                )
                to, step = (y0 * width + x0) * image_channels, width * image_channels
                if image_channels == 4:
                    store(flat, to, rows[0])
                    store(flat, to + step, rows[1])
                    store(flat, to + 2 * step, rows[2])
                    store(flat, to + 3 * step, rows[3])
                else:
                    store_rgb(flat, to, rows[0])
                    store_rgb(flat, to + step, rows[1])
                    store_rgb(flat, to + 2 * step, rows[2])
                    store_rgb(flat, to + 3 * step, rows[3])
            for down in range(min(4, height - y0)):
                for across in range(min(4, width - x0)):
                    lane = down * 4 + across
                    y, x = np.uint64(y0 + down), np.uint64(x0 + across)
                    alpha[y, x] = np.float32(1.0) - abs(transmittance[np.uint64(pixel_start + lane)])
                    if whole:
                        continue
                    for channel in range(image_channels):
                        image[y, x, np.uint64(channel)] = colours[np.uint64(color_start + channel * PIXELS + lane)]


@kernel()
def _gradients_to_blocks(
    tile_y: int,
    grad_image: Float32,
    grad_alpha: Float32,
    remaining: Float32,
    channels: int,
    tiles_x: int,
    grad_colours: Float32,
    transmittance: Float32,
    background_sum: Float32,
) -> None:
    """Copy the gradients of a row of tiles to blocks."""
    height, width, image_channels = grad_image.shape
    for tile_x in range(tiles_x):
        tile = tile_y * tiles_x + tile_x
        for block in range(BLOCKS):
            y0, x0 = tile_y * TILE_PX + block // 4 * 4, tile_x * TILE_PX + block % 4 * 4
            pixel_start, color_start = tile * PIXELS + block * LANES, tile * channels * PIXELS + block * LANES
            for lane in range(LANES):
                at = np.uint64(pixel_start + lane)
                transmittance[at], background_sum[at] = abs(remaining[at]), np.float32(0.0)
                y, x = np.uint64(y0 + lane // 4), np.uint64(x0 + lane % 4)
                if y < np.uint64(height) and x < np.uint64(width):
                    background_sum[at] = -transmittance[at] * grad_alpha[y, x]
                    for channel in range(image_channels):
                        place = np.uint64(color_start + channel * PIXELS + lane)
                        grad_colours[place] = grad_image[y, x, np.uint64(channel)]
