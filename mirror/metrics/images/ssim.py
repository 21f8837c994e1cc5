"""Structural similarity of an image: four named definitions, three named ways to mask.

The map is `mirror.metrics.images.ssim_map`'s; a mask costs no more than the box around it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, Literal, NoReturn, TypeAlias, overload

import cv2
import numpy as np

from mirror.arrays import AnyArray, Bool
from mirror.errors import UsageError
from mirror.metrics.images.aggregate import Summary, summarise
from mirror.metrics.images.pairs import ImagePair, as_pair, as_pairs
from mirror.metrics.images.ssim_map import Precision, SsimSettings, map_tiles
from mirror.metrics.inputs import BatchLayout, ImageLayout, Layout, Pixels, as_image, of_layout
from mirror.metrics.score import EMPTY_MASK, Score

MaskMode: TypeAlias = Literal["map", "erode", "normalised"]

PRESETS: Final[Mapping[str, SsimSettings]] = MappingProxyType(
    {
        "gaussian11": SsimSettings("gaussian", 11, 1.5, "valid"),
        "uniform7": SsimSettings("uniform", 7, 1.5, "valid", sample_covariance=True),
        "torchmetrics": SsimSettings("gaussian", 11, 1.5, "reflect"),
        "3dgs": SsimSettings("gaussian", 11, 1.5, "zero"),
    }
)
MASK_MODES: Final = ("map", "erode", "normalised")

_NO_WINDOW: Final = "no selected pixel has its whole window in the image"
_NO_WHOLE_WINDOW: Final = "no selected pixel has its whole window in the mask"


@overload
def ssim(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    preset: str | SsimSettings = "gaussian11",
    mask_mode: MaskMode = "map",
    data_range: float | None = None,
    precision: Precision = "float64",
    layout: ImageLayout | None = None,
) -> Score: ...
@overload
def ssim(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    preset: str | SsimSettings = "gaussian11",
    mask_mode: MaskMode = "map",
    data_range: float | None = None,
    precision: Precision = "float64",
    layout: BatchLayout,
) -> list[Score]: ...
def ssim(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    preset: str | SsimSettings = "gaussian11",
    mask_mode: MaskMode = "map",
    data_range: float | None = None,
    precision: Precision = "float64",
    layout: Layout | None = None,
) -> Score | list[Score]:
    """Return the SSIM of an image: the mean of its map over selected pixels and channels.

    Args:
        render: (H, W) or (H, W, C), or as ``layout`` says; an array or a torch tensor on the CPU, of uint8, uint16,
            float32 or float64.
        truth: of the same shape and type.
        mask: (H, W) bool, true where pixels count; of a batch also (N, H, W).
        preset: a name in `PRESETS`, or settings of your own.
        mask_mode: ``map`` averages the map over the mask; windows see the pixels beside it. ``erode`` averages only
            where the whole window is in the mask. ``normalised`` leaves pixels outside the mask out of every window
            and weighs the others up.
        data_range: what separates black from white; None: 255 or 65535. Floats need it.
        precision: ``float32`` takes two thirds of the time; the map is then right to 2e-4.
        layout: ``hw``, ``hwc`` or ``chw`` of an image, ``nhw``, ``nhwc`` or ``nchw`` of a batch; None: (H, W), or
            arrays (H, W, C). Tensors of more axes need it.

    Returns:
        At most 1, and 1 for equal images; NaN with a reason where no pixel is left. Of a batch a list, one score an
        image.

    Raises:
        UsageError: the images cannot be compared (`as_pair`), they are smaller than the window and the border is
            ``valid``, a name is unknown, or windows reach a pixel that is NaN or infinite.
    """
    settings, pairs = _settings(preset), as_pairs(render, truth, mask, data_range, layout)
    return of_layout([_ssim(pair, settings, mask_mode, precision) for pair in pairs], layout)


def ssim_map(
    render: Pixels,
    truth: Pixels,
    *,
    preset: str | SsimSettings = "gaussian11",
    data_range: float | None = None,
    precision: Precision = "float64",
    layout: ImageLayout | None = None,
) -> AnyArray:
    """Return the map of which `ssim` is the mean.

    Args:
        render: as of `ssim`.
        truth: as of `ssim`.
        preset: as of `ssim`.
        data_range: as of `ssim`.
        precision: as of `ssim`; the map's type.
        layout: of the images; that of the map does not follow it.

    Returns:
        (H, W, C), or (H, W) for images of that shape; NaN where the window leaves the image and the border is
        ``valid``.

    Raises:
        UsageError: as of `ssim`.
    """
    images = as_image(render, "render", layout), as_image(truth, "truth", layout)
    settings, pair = _settings(preset), as_pair(*images, None, data_range)
    part = _part(pair, settings)
    found = np.full(pair.render.shape, np.nan, precision)
    inside = found[part.rows, part.columns]
    start = 0
    for tile in _tiles(pair, None, part, settings, precision):
        inside[start : start + len(tile)] = tile
        start += len(tile)
    if np.isnan(inside).any():
        _refuse(pair, None)
    return found.reshape(images[0].shape)


class Ssim:
    """An accumulator of SSIM, whose summary holds the mean over images.

    Args:
        preset: as of `ssim`.
        mask_mode: as of `ssim`.
        data_range: as of `ssim`.
        precision: as of `ssim`.
    """

    def __init__(
        self,
        preset: str | SsimSettings = "gaussian11",
        mask_mode: MaskMode = "map",
        data_range: float | None = None,
        precision: Precision = "float64",
    ) -> None:
        self.settings = _settings(preset)
        self.mask_mode, self.data_range, self.precision = mask_mode, data_range, precision
        self.scores: list[Score] = []

    @overload
    def update(
        self, render: Pixels, truth: Pixels, mask: Pixels | None = None, *, layout: ImageLayout | None = None
    ) -> Score: ...
    @overload
    def update(
        self, render: Pixels, truth: Pixels, mask: Pixels | None = None, *, layout: BatchLayout
    ) -> list[Score]: ...
    def update(
        self, render: Pixels, truth: Pixels, mask: Pixels | None = None, *, layout: Layout | None = None
    ) -> Score | list[Score]:
        """Add an image or a batch; see `ssim` for arguments, result and errors."""
        pairs = as_pairs(render, truth, mask, self.data_range, layout)
        scores = [_ssim(pair, self.settings, self.mask_mode, self.precision) for pair in pairs]
        self.scores.extend(scores)
        return of_layout(scores, layout)

    def merge(self, other: Ssim) -> None:
        """Add the images of another accumulator.

        Raises:
            UsageError: it has another SSIM.
        """
        mine, theirs = ((one.settings, one.mask_mode, one.data_range, one.precision) for one in (self, other))
        if mine != theirs:
            raise UsageError(f"SSIM of {theirs} cannot join that of {mine}", expected="one definition")
        self.scores.extend(other.scores)

    def compute(self) -> Summary:
        """Return the summary so far."""
        return summarise(self.scores)


@dataclass(frozen=True)
class _Part:
    """Where windows have their centres; ``selected`` is None where all do."""

    rows: slice
    columns: slice
    selected: Bool | None


def _settings(preset: str | SsimSettings) -> SsimSettings:
    if isinstance(preset, SsimSettings):
        return preset
    if preset not in PRESETS:
        raise UsageError(f"SSIM preset {preset!r}", expected=f"one of {', '.join(PRESETS)}")
    return PRESETS[preset]


def _ssim(pair: ImagePair, settings: SsimSettings, mask_mode: MaskMode, precision: Precision) -> Score:
    if mask_mode not in MASK_MODES:
        raise UsageError(f"mask mode {mask_mode!r}", expected=f"one of {', '.join(MASK_MODES)}")
    if pair.empty:
        return EMPTY_MASK
    part = _part(pair, settings, erode=mask_mode == "erode")
    if part.selected is not None and not part.selected.any():
        return Score(math.nan, _NO_WHOLE_WINDOW if mask_mode == "erode" else _NO_WINDOW)
    known = pair.mask if mask_mode == "normalised" else None
    sums, count, start = [], 0, 0
    for tile in _tiles(pair, known, part, settings, precision):
        chosen = tile if part.selected is None else tile[part.selected[start : start + len(tile)]]
        sums.append(float(chosen.sum(dtype=np.float64)))
        count += chosen.size
        start += len(tile)
    total = math.fsum(sums)
    if math.isnan(total):
        _refuse(pair, known)
    return Score(total / count)


def _part(pair: ImagePair, settings: SsimSettings, erode: bool = False) -> _Part:
    height, width = pair.render.shape[:2]
    edge = settings.radius if settings.border == "valid" else 0
    if height <= 2 * edge or width <= 2 * edge:
        raise UsageError(
            f"an image of {width} x {height} px",
            expected=f"at least {settings.size} px each way for windows inside the image",
            remedy="take a preset whose windows may leave the image: torchmetrics or 3dgs",
        )
    if pair.mask is None:
        return _Part(slice(edge, height - edge), slice(edge, width - edge), None)
    selected = pair.mask[edge : height - edge, edge : width - edge]
    if erode:
        box = np.ones((settings.size, settings.size), np.uint8)
        eroded = cv2.erode(np.ascontiguousarray(pair.mask).view(np.uint8), box)
        selected = eroded[edge : height - edge, edge : width - edge].view(np.bool_)
    rows, columns = (_extent(np.any(selected, axis=axis)) for axis in (1, 0))
    return _Part(
        slice(rows.start + edge, rows.stop + edge),
        slice(columns.start + edge, columns.stop + edge),
        selected[rows, columns],
    )


def _extent(used: Bool) -> slice:
    """From the first true value to the last."""
    where = np.flatnonzero(used)
    return slice(int(where[0]), int(where[-1]) + 1) if len(where) else slice(0, 0)


def _tiles(
    pair: ImagePair, known: Bool | None, part: _Part, settings: SsimSettings, precision: Precision
) -> Iterator[AnyArray]:
    if precision not in ("float64", "float32"):
        raise UsageError(f"precision {precision!r}", expected="float64 or float32")
    return map_tiles(pair.render, pair.truth, known, part.rows, part.columns, settings, precision, pair.data_range)


def _refuse(pair: ImagePair, known: Bool | None) -> NoReturn:
    """Say why the map is not finite."""
    replace(pair, mask=known).refuse_non_finite()
    raise UsageError("squares of pixels are too large", expected=f"pixels near {pair.data_range}")
