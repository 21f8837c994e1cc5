"""What callers give to metrics: numpy arrays, or torch tensors on the CPU. Torch is never imported for it."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, TypeVar, cast, get_args

import numpy as np
import numpy.typing as npt

from mirror.arrays import AnyArray, Bool
from mirror.errors import UsageError

if TYPE_CHECKING:
    from torch import Tensor

Pixels: TypeAlias = "AnyArray | Tensor"
"""A numpy array, or a torch tensor on the CPU."""
Numbers: TypeAlias = "npt.ArrayLike | Tensor"
"""Numbers of any kind: a list, an array, or a torch tensor on the CPU."""

ImageLayout: TypeAlias = Literal["hw", "hwc", "chw"]
"""One image: h rows, w columns, c channels."""
BatchLayout: TypeAlias = Literal["nhw", "nhwc", "nchw"]
"""n images."""
Layout: TypeAlias = ImageLayout | BatchLayout

_IMAGE: Final = get_args(ImageLayout)
_BATCH: Final = get_args(BatchLayout)
_MOST_CHANNELS: Final = 4

_Result = TypeVar("_Result")


def as_array(value: Pixels, what: str) -> AnyArray:
    """Return an array, or the values of a torch tensor, without a copy.

    Raises:
        UsageError: it is neither, or a tensor that is not on the CPU, takes part in a gradient, or is of a type that
            numpy lacks.
    """
    if isinstance(value, np.ma.MaskedArray):
        raise UsageError(f"{what} is a masked array", remedy="pass its data, and what counts as mask=")
    if isinstance(value, np.ndarray):
        return value
    if not _is_tensor(value):
        raise UsageError(
            f"{what} is a {type(value).__module__}.{type(value).__qualname__}",
            expected="a numpy array or a torch tensor on the CPU",
            remedy="numpy.asarray(...) of an image or a list",
        )
    if value.device.type != "cpu":
        raise UsageError(f"{what} is a tensor on {value.device}", expected="one on the CPU", remedy="pass .cpu()")
    if value.requires_grad:
        raise UsageError(
            f"{what} is a tensor that requires a gradient, which no metric here has", remedy="pass .detach()"
        )
    try:
        return value.resolve_conj().resolve_neg().numpy()
    except (RuntimeError, TypeError) as error:
        raise UsageError(
            f"{what} is a tensor of {value.dtype} and {value.layout}: {error}",
            expected="a dense tensor of a type that numpy has",
            remedy="pass .float() or .to_dense()",
        ) from error


def as_numbers(values: Numbers, what: str, dtype: type[np.float64] | None = None) -> AnyArray:
    """Return the numbers of a list, an array or a torch tensor as an array.

    Args:
        values: the numbers.
        what: its name in messages.
        dtype: to convert to; None: that of the values.

    Raises:
        UsageError: they are not numbers, or a tensor that `as_array` refuses.
    """
    given: Any = as_array(cast("Tensor", values), what) if _is_tensor(values) else values
    try:
        array = np.asarray(given, dtype=dtype)
    except (TypeError, ValueError, RuntimeError) as error:
        raise UsageError(f"{what} is no array of numbers: {error}", expected="a list, an array or a tensor") from error
    if array.dtype.kind not in "biuf":
        raise UsageError(f"{what} is of type {array.dtype}", expected="numbers")
    return array


def require_rows(valid: Bool | np.bool_, name: str, values: AnyArray, expected: str) -> None:
    """Raise an error if a row of values is not valid.

    Args:
        valid: (N,).
        name: of the values, in the message.
        values: (N, ...).
        expected: what a row must be.

    Raises:
        UsageError: it names the first row that is not valid.
    """
    if not np.all(valid):
        row = int(np.argmin(valid))
        raise UsageError(f"{name} {values[row].tolist()}", place=f"row {row}", expected=expected)


def as_images(value: Pixels, what: str, layout: Layout | None) -> list[AnyArray]:
    """Return a list of images (H, W) or (H, W, C): a single image, or all images of a batch.

    Args:
        value: pixels.
        what: its name in messages.
        layout: of ``value``; None: (H, W), or an array (H, W, C). The axes of a tensor are not guessed.

    Raises:
        UsageError: `as_array` refuses it, the layout is unknown or missing, or the shape is another.
    """
    arranged = channels_last(value, what, layout)
    return list(arranged) if is_batch(layout) else [arranged]


def as_image(value: Pixels, what: str, layout: ImageLayout | None) -> AnyArray:
    """Return one image (H, W) or (H, W, C); see `as_images`.

    Raises:
        UsageError: as of `as_images`, or the layout is that of a batch.
    """
    if layout is not None and layout not in _IMAGE:
        raise UsageError(f"layout={layout!r}", expected=f"one image: {_listed(_IMAGE)}")
    return channels_last(value, what, layout)


def images_of(values: Iterable[Pixels], what: str, layout: Layout | None) -> Iterator[AnyArray]:
    """Yield single images from images and batches.

    Raises:
        UsageError: as of `as_images`.
    """
    for value in values:
        yield from as_images(value, what, layout)


def as_masks(mask: Pixels | None, layout: Layout | None, count: int) -> Sequence[AnyArray | None]:
    """Return the masks of images: one mask (H, W) for all images, or (N, H, W) for a batch.

    Raises:
        UsageError: `as_array` refuses it, or there are not as many as images.
    """
    if mask is None:
        return [None] * count
    given = as_array(mask, "mask")
    if not is_batch(layout) or given.ndim == 2:
        return [given] * count
    if given.ndim != 3 or len(given) != count:
        raise UsageError(f"mask of shape {given.shape} for {count} images", expected="(H, W) or (N, H, W)")
    return list(given)


def channels_last(value: Pixels, what: str, layout: Layout | None) -> AnyArray:
    """Return the pixels with the channels on the last axis, contiguous if a layout is given.

    Raises:
        UsageError: as of `as_images`.
    """
    array = as_array(value, what)
    if layout is None:
        if array.ndim == 4 or (array.ndim == 3 and _is_tensor(value)):
            kind, layouts = ("a batch", _BATCH) if array.ndim == 4 else ("a tensor", _IMAGE[1:] + _BATCH[:1])
            raise UsageError(
                f"{what} is {kind} of shape {tuple(array.shape)} and has no layout",
                expected=f"layout= one of {_listed(layouts)}",
            )
        return array
    if layout not in _IMAGE + _BATCH:
        raise UsageError(f"layout={layout!r}", expected=f"one of {_listed(_IMAGE + _BATCH)}")
    if array.ndim != len(layout):
        raise UsageError(f"{what} of shape {tuple(array.shape)}", expected=f"{len(layout)} axes: layout={layout!r}")
    if "c" in layout and not 1 <= array.shape[layout.index("c")] <= _MOST_CHANNELS:
        raise UsageError(
            f"{what} of shape {tuple(array.shape)} has {array.shape[layout.index('c')]} channels by layout={layout!r}",
            expected=f"1 to {_MOST_CHANNELS}",
            remedy="name the layout that the shape has",
        )
    return np.ascontiguousarray(np.moveaxis(array, layout.index("c"), -1) if "c" in layout else array)


def is_batch(layout: Layout | None) -> bool:
    """Return whether a layout is a batch of images."""
    return layout in _BATCH


def of_layout(results: Sequence[_Result], layout: Layout | None) -> Any:
    """Return the first result for a layout of one image, or the list of all results for a batch."""
    return list(results) if is_batch(layout) else results[0]


def _is_tensor(value: object) -> bool:
    # What is not imported has made no tensor.
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)


def _listed(layouts: Sequence[str]) -> str:
    return ", ".join(repr(layout) for layout in layouts)
