"""Extractors of edited regions, one a file; an extractor sees two renders, and never the target box."""

from __future__ import annotations

from typing import Final

from mirror.errors import UsageError
from mirror.evaluation.extractors.extractor import Extractor

__all__ = ["EXTRACTORS", "Extractor", "extractor_of"]

EXTRACTORS: Final = {
    "diff-grabcut": "what differs from the background, cut out by GrabCut; needs no weights",
    "file": "file:FOLDER, masks that somebody else extracted",
    "onnx-sam": "onnx-sam:FOLDER, Segment Anything as encoder.onnx and decoder.onnx",
}
"""By name, with their arguments."""


def make_extractor(text: str) -> Extractor:
    """The extractor of a name and its argument, as ``--extractor`` has them.

    Raises:
        UsageError: there is none of that name, or its argument is missing or too much.
    """
    name, colon, argument = text.partition(":")
    if name not in EXTRACTORS or bool(colon) == (name == "diff-grabcut"):
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
