"""Development: converts radiance to an 8-bit image, for one camera in one condition."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float32, Float64, Records, UInt8
from mirror.compiled import inner_numpy_njit
from mirror.errors import UsageError
from mirror.synth.light.condition import Effects
from mirror.synth.render.develop.camera_response import CameraResponse
from mirror.synth.render.develop.curve import BRIGHTEST, STEPS, film_table, gaussian_table
from mirror.synth.render.develop.drops import refract_drops
from mirror.synth.render.develop.exposure import compute_exposure
from mirror.synth.render.develop.glare import QUARTER, glare
from mirror.synth.render.develop.motion import apply_motion_blur

_VIVID: Final = 1.12
"""Factor of the colour saturation."""
_SCALE: Final = (STEPS - 1) / math.sqrt(BRIGHTEST)


def develop(
    radiance: Float32,
    record: Records,
    response: CameraResponse,
    effects: Effects,
    seed: int,
    *,
    motion: Float32 | None = None,
    drops: Records | None = None,
) -> UInt8:
    """Convert radiance to an 8-bit image; the same arguments give the same bytes on any thread.

    Args:
        radiance: (H, W, 3) red, green, blue; not modified.
        record: LIGHTING record.
        response: the camera's response to light.
        effects: effects to be rendered.
        seed: seed of the noise; each image needs its own.
        motion: (H, W, 2) motion of each pixel during the exposure, in pixels, from `compute_image_motion`.
        drops: (N,) DROP: rain drops on the lens, from `lens_drops`.

    Returns:
        (H, W, 3) pixels, blue first.

    Raises:
        UsageError: an array has a wrong shape or type, or the radiance is not finite.
    """
    if radiance.ndim != 3 or radiance.shape[2] != 3 or radiance.dtype != np.float32 or not radiance.size:
        raise UsageError(f"radiance {radiance.dtype} {radiance.shape}", expected="float32 (H, W, 3), H and W above 0")
    if motion is not None and motion.shape != (*radiance.shape[:2], 2):
        raise UsageError(f"motion of shape {motion.shape}", expected=f"{(*radiance.shape[:2], 2)}")
    image = np.ascontiguousarray(radiance)
    if effects.motion_blur and motion is not None:
        image = apply_motion_blur(image, motion)
    if effects.lens_drops and drops is not None and len(drops):
        image = refract_drops(image, drops)
    gains = np.full(3, compute_exposure(radiance, record, response, effects))
    if effects.white_balance:
        gains *= record["white"] * response.tint
    spilt = glare(image, gains) if effects.bloom else None
    if spilt is None:
        spilt = np.zeros((0, 0, 3), np.float32)
    read, shot = 0.0, 0.0
    if effects.noise:
        read, shot = float(record["read_noise"]) * response.noise, float(record["shot_noise"]) * response.noise**2
    vignette = response.vignette if effects.vignetting else 0.0
    out = _film(image, spilt, gains, vignette, read * read, shot, film_table(), gaussian_table(), seed)
    if not out.size:
        raise UsageError("radiance that is infinite or no number", expected="finite radiance")
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _film(
    image: Float32,
    spilt: Float32,
    gains: Float64,
    vignette: float,
    read: float,
    shot: float,
    table: UInt8,
    normal: Float64,
    seed: int,
) -> UInt8:
    height, width = image.shape[:2]
    out = np.empty((height, width, 3), np.uint8)
    brightest, scale, vivid = np.float32(BRIGHTEST), np.float32(_SCALE), np.float32(_VIVID)
    red_gain, green_gain, blue_gain = np.float32(gains[0]), np.float32(gains[1]), np.float32(gains[2])
    read32, shot32 = np.float32(read), np.float32(shot)
    corner = np.float32(vignette / (0.25 * (height * height + width * width)))
    unity, zero, half = np.float32(1.0), np.float32(0.0), np.float32(0.5)
    noisy = read > 0.0 or shot > 0.0
    glares = spilt.shape[0] > 0
    start = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15)
    between = np.zeros((spilt.shape[1] + 2, 3), np.float32)
    row_spilt = np.zeros((max(QUARTER * spilt.shape[1], width), 3), np.float32)
    for row in range(height):
        if glares:
            _upsample(spilt, row, between, row_spilt)
        y = np.float32(row + 0.5 - 0.5 * height)
        for column in range(width):
            x = np.float32(column + 0.5 - 0.5 * width)
            fall = unity / (unity + corner * (x * x + y * y))
            fall *= fall
            red = (image[row, column, 0] * red_gain + row_spilt[column, 0]) * fall
            green = (image[row, column, 1] * green_gain + row_spilt[column, 1]) * fall
            blue = (image[row, column, 2] * blue_gain + row_spilt[column, 2]) * fall
            grey = np.float32(0.2126) * red + np.float32(0.7152) * green + np.float32(0.0722) * blue
            if not abs(grey) < np.inf:
                return np.empty((0, 0, 3), np.uint8)
            red = min(max(grey + vivid * (red - grey), zero), brightest)
            green = min(max(grey + vivid * (green - grey), zero), brightest)
            blue = min(max(grey + vivid * (blue - grey), zero), brightest)
            if noisy:
                # A xor-shift multiply hash (D. Stafford's variant 13 of MurmurHash3's finalizer).
                bits = start + np.uint64(row * width + column) * np.uint64(0xD1B54A32D192ED03)
                bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
                bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
                bits = bits ^ (bits >> np.uint64(31))
                red += math.sqrt(read32 + shot32 * red) * np.float32(normal[bits & np.uint64(4095)])
                green += math.sqrt(read32 + shot32 * green) * np.float32(
                    normal[(bits >> np.uint64(12)) & np.uint64(4095)]
                )
                blue += math.sqrt(read32 + shot32 * blue) * np.float32(
                    normal[(bits >> np.uint64(24)) & np.uint64(4095)]
                )
                red = min(max(red, zero), brightest)
                green = min(max(green, zero), brightest)
                blue = min(max(blue, zero), brightest)
            out[row, column, 0] = table[int(math.sqrt(blue) * scale + half)]
            out[row, column, 1] = table[int(math.sqrt(green) * scale + half)]
            out[row, column, 2] = table[int(math.sqrt(red) * scale + half)]
    return out


@inner_numpy_njit
def _upsample(small: Float32, row: int, between: Float32, out: Float32) -> None:
    """Upsample one row to full resolution, bilinearly between the middles of blocks.

    Args:
        small: (h, w, 3) values of blocks.
        row: row of the full resolution.
        between: (w + 2, 3) buffer, overwritten: the row between two rows of ``small``, with repeated ends.
        out: (4 w, 3) output.
    """
    rows, columns = small.shape[:2]
    y = min(max((row + 0.5) / QUARTER - 0.5, 0.0), rows - 1.0)
    i = int(y)
    v, below = np.float32(y - i), min(i + 1, rows - 1)
    for column in range(columns):
        for channel in range(3):
            above = small[i, column, channel]
            between[column + 1, channel] = above + v * (small[below, column, channel] - above)
    for channel in range(3):
        between[0, channel], between[columns + 1, channel] = between[1, channel], between[columns, channel]
    for column in range(columns):
        for channel in range(3):
            before, here, after = between[column, channel], between[column + 1, channel], between[column + 2, channel]
            out[4 * column, channel] = here + np.float32(0.375) * (before - here)
            out[4 * column + 1, channel] = here + np.float32(0.125) * (before - here)
            out[4 * column + 2, channel] = here + np.float32(0.125) * (after - here)
            out[4 * column + 3, channel] = here + np.float32(0.375) * (after - here)
