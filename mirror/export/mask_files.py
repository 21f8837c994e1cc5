"""Masks of images as files, for toolkits that read a dataset without an export and take masks by path."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mirror.export.files import encode_image
from mirror.export.scene import ExportImage


def write_mask_files(images: Sequence[ExportImage]) -> list[Path] | None:
    """Write the masks of images, white where they show the static street, into a folder that ends with the process.

    Returns:
        A file for each image; None: no image has a mask.
    """
    masks = [item.valid_pixels() for item in images]
    if all(mask is None for mask in masks):
        return None
    folder = Path(tempfile.mkdtemp(prefix="mirror-masks-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    files = []
    for number, (item, mask) in enumerate(zip(images, masks)):
        files.append(folder / f"{number:08}.png")
        whole = np.full((item.lens.height_px, item.lens.width_px), 255, np.uint8) if mask is None else mask
        files[-1].write_bytes(encode_image(whole, ".png"))
    return files
