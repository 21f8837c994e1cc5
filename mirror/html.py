"""What the toolkit's pages share: their style sheet, tables and images that a page holds itself."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from typing import Final

from mirror.arrays import UInt8

_JPEG_QUALITY: Final = 80


def style_sheet() -> str:
    """The CSS of all pages."""
    return files("mirror.pages").joinpath("style.css").read_text()


def html_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table that scrolls sideways where it is too wide; columns whose names begin with ``n:`` are numbers."""
    kinds = [' class="n"' if name.startswith("n:") else "" for name in head]
    heads = "".join(f"<th{kind}>{escape(name.removeprefix('n:'))}</th>" for name, kind in zip(head, kinds))
    body = "".join(f"<tr>{''.join(f'<td{kind}>{cell}</td>' for cell, kind in zip(row, kinds))}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table></div>'


def inline_image(image: UInt8, alt: str, width_px: int) -> str:
    """An ``img`` that holds its image.

    Args:
        image: (H, W, 3), RGB.
        alt: what it shows, in words.
        width_px: wider images are scaled down.
    """
    import cv2
    import numpy as np

    height, width = image.shape[:2]
    if width > width_px:
        size = (width_px, round(height * width_px / width))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    encoded = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
    data = base64.b64encode(encoded.tobytes()).decode()
    size_text = f'width="{image.shape[1]}" height="{image.shape[0]}"'
    return f'<img alt="{escape(alt)}" {size_text} src="data:image/jpeg;base64,{data}">'
