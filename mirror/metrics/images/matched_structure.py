"""Structure at several scales that a render matches, ``matched_structure``: the key that ranks renders.

It is `ms_structure` (its module has the definition) in a form in which changes that show nothing more gain less. On a
street where five trained methods are close, the figures of docs/threat-model/figures.md made three changes necessary:

- A window counts where the render explains more than `LEAST_SHARE` of the truth's variance, and by what it explains
  beyond. Structure beside its place explains some of it everywhere, and a blur improves all of that a little.
- The band of an octave leaves out what is finer than the octave: a gaussian of `FINE_SIGMA_PX` smooths both images
  first. Noise of a render lies there, which any smoothing removes.
- A render gets the best of its luma, its channels and the logarithms of these. Light of another hour changes contrast
  like a power of the brightness, which scales the logarithm and leaves its correlation.
"""

from __future__ import annotations

from typing import Final, overload

from mirror.metrics.images.pairs import as_pairs
from mirror.metrics.images.structure import StructureForm, score_structure
from mirror.metrics.inputs import BatchLayout, ImageLayout, Layout, Pixels, of_layout
from mirror.metrics.score import Score

LEAST_SHARE: Final = 0.6
"""Share of the truth's variance up to which a window gains nothing."""

FINE_SIGMA_PX: Final = 0.7
"""Standard deviation of the gaussian that smooths each octave first, in pixels of its scale."""

_FORM: Final = StructureForm(fine_sigma_px=FINE_SIGMA_PX, least_share=LEAST_SHARE, has_logarithms=True)


@overload
def matched_structure(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: ImageLayout | None = None,
) -> Score: ...
@overload
def matched_structure(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: BatchLayout,
) -> list[Score]: ...
def matched_structure(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: Layout | None = None,
) -> Score | list[Score]:
    """Return the mean share of the local structure of the truth's luma that the render matches, over four octaves.

    Args:
        render: (H, W) or (H, W, C) with C of 1 or 3, or as ``layout`` says; an array or a torch tensor on the CPU, of
            uint8, uint16, float32 or float64. Black is 0: values below count as 0 in the logarithms.
        truth: of the same shape and type.
        mask: (H, W) bool, True where pixels count; for a batch also (N, H, W). Other pixels take part in no window.
        data_range: white minus black; None: 255 or 65535. Floats need it.
        layout: ``hw``, ``hwc`` or ``chw`` of an image, ``nhw``, ``nhwc`` or ``nchw`` of a batch; None: (H, W), or
            arrays (H, W, C). Tensors of more axes need it.

    Returns:
        Score from 0 to 1; for a batch a list with one for each image. 0.95 and more for equal images, 0 for a render
        without structure; NaN with a reason for an empty mask, or if the truth has no structure.

    Raises:
        UsageError: the images cannot be compared (`as_pair`), they have neither 1 nor 3 channels, or a selected pixel
            is NaN or infinite.
    """
    return of_layout(
        [score_structure(pair, _FORM) for pair in as_pairs(render, truth, mask, data_range, layout)], layout
    )
