"""The sample of images that persons review, and what it says of the images that nobody reviewed."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

from mirror.privacy.log import ImageRecord, Review
from mirror.schema.documents import Document
from mirror.schema.json_lines import read_lines
from mirror.schema.strict_json import decode_json

REVIEWS: Final = "reviews.jsonl"
CONFIDENCE: Final = 0.95
DEFAULT_SAMPLE: Final = 300
"""Without a miss in 300 images, at most 1 % of all images have one, with 95 % confidence: the rule of three."""


class ReviewedImage(Document):
    """One line of the file that the review page writes; of several lines of an image the last counts.

    Attributes:
        out_sha256: SHA-256 of the redacted bytes.
        review: what was said.
    """

    out_sha256: str
    review: Review


def choose_sample(records: Iterable[ImageRecord], count: int, seed: str = "") -> list[ImageRecord]:
    """Choose images by the hash of their bytes: anyone can repeat the choice, and nobody can influence it.

    Args:
        records: the log.
        count: number of images; all, if there are fewer.
        seed: a text that is hashed with each image.
    """

    def draw(record: ImageRecord) -> str:
        return hashlib.sha256(f"{seed}:{record.out_sha256}".encode()).hexdigest()

    return sorted(records, key=draw)[:count]


def miss_bound(misses: int, images: int) -> float:
    """Return the Clopper-Pearson bound of the share of images with a miss, one-sided, 95 %; 1 without images.

    Without a miss it is close to 3 / images.
    """
    if images == 0 or misses >= images:
        return 1.0
    if misses == 0:
        return float(-math.expm1(math.log(1.0 - CONFIDENCE) / images))
    low, high = misses / images, 1.0
    for _ in range(100):
        middle = 0.5 * (low + high)
        at_most = sum(
            math.exp(
                math.lgamma(images + 1) - math.lgamma(k + 1) - math.lgamma(images - k + 1)
                + k * math.log(middle) + (images - k) * math.log1p(-middle)
            )
            for k in range(misses + 1)
        )  # fmt: skip
        low, high = (middle, high) if at_most > 1.0 - CONFIDENCE else (low, middle)
    return high


def read_reviews(path: Path) -> dict[str, Review]:
    """Return the reviews by the hash of the redacted image; empty without a file.

    Raises:
        DatasetError: a line is broken.
    """
    found = read_lines(path, lambda line: ReviewedImage.model_validate(decode_json(line)))
    return {reviewed.out_sha256: reviewed.review for reviewed in found}


def with_reviews(records: Sequence[ImageRecord], reviews: Mapping[str, Review]) -> list[ImageRecord]:
    """Return the log with the answers of reviewers."""
    return [record.model_copy(update={"review": reviews.get(record.out_sha256, record.review)}) for record in records]
