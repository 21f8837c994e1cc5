"""Extractors of edited regions, one in each file; an extractor gets two renders but never the target box."""

from __future__ import annotations

from typing import Final

from mirror.errors import UsageError
from mirror.evaluation.extractors.extractor import ObjectExtractor

__all__ = ["DEFAULT_EXTRACTOR", "EXTRACTORS", "Extractor", "ObjectExtractor", "make_extractor"]

Extractor = ObjectExtractor
"""The name of `ObjectExtractor` in version 0.1; it stays importable from here."""

DEFAULT_EXTRACTOR: Final = "diff-grabcut"
"""The only extractor that comes with the toolkit, and so the only one whose regions can be verified."""

EXTRACTORS: Final = {
    "diff-grabcut": "diff-grabcut, the region that differs from the background, refined by GrabCut; needs no weights",
    "file": "file:FOLDER, masks from files",
    "onnx-sam": "onnx-sam:FOLDER, Segment Anything as encoder.onnx and decoder.onnx",
}
"""Extractors by name, each with its argument and description."""


def make_extractor(text: str) -> ObjectExtractor:
    """Make an extractor from the text of ``--extractor``: a name, and for some extractors a colon and an argument.

    Raises:
        UsageError: the name is unknown, or the argument is missing or superfluous.
    """
    name, colon, argument = text.partition(":")
    if name not in EXTRACTORS or bool(colon) == (name == DEFAULT_EXTRACTOR):
        listed = "; ".join(EXTRACTORS.values())
        raise UsageError(f"no extractor {text!r}", place="--extractor", expected=listed)
    if name == "file":
        from mirror.evaluation.extractors.from_file import MaskFiles

        return MaskFiles(argument)
    if name == "onnx-sam":
        from mirror.evaluation.extractors.onnx_sam import OnnxSam

        return OnnxSam(argument)
    from mirror.evaluation.extractors.diff_grabcut import DiffGrabCut

    return DiffGrabCut()
