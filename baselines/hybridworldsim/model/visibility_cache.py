"""Which rows each training image showed when all were last decoded; hidden rows are skipped for some visits."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.trainable.viewpoint import Viewpoint
from mirror.arrays import Bool, Int64, UInt8

_FULL_EVERY: Final = 4
"""Every so many visits all rows are decoded, because what hid a row may have moved."""
MAX_BYTES: Final = 1 << 26
_DIGEST: Final = 16


@dataclass
class _VisitRecord:
    """Of one image: the number of visits, and for each node one bit for each row, set where the row was visible."""

    visits: int = 0
    shown: list[UInt8] = field(default_factory=list)


class VisibilityCache:
    """A record of the rows of nodes that each training image shows.

    About half of the rows in a street's view frustum are hidden: their gradients are zero, and they cost as much as
    visible rows. Rows that an image did not show are skipped at its next three visits; rows that were added since are
    not skipped. A row costs one bit for each image, at most 64 MiB in all; images beyond that are decoded completely.
    """

    def __init__(self) -> None:
        self._records: dict[bytes, _VisitRecord] = {}
        self._bytes = 0

    def select_rows(self, viewpoint: Viewpoint, visible: Sequence[Tensor], numbers: Sequence[Tensor]) -> list[Tensor]:
        """Select the rows worth decoding among the rows that a viewpoint may see.

        Args:
            viewpoint: camera of the image.
            visible: rows (M,) of each node that the viewpoint may see.
            numbers: numbers (N,) of all rows of each node, see `LazyAdam.numbers`.
        """
        record = self._records.get(_key(viewpoint))
        if record is None or not record.shown:
            return list(visible)
        return [
            rows[torch.from_numpy(_is_worth_decoding(shown, own_numbers[rows].numpy()))]
            for rows, own_numbers, shown in zip(visible, numbers, record.shown)
        ]

    def record(self, viewpoint: Viewpoint, shown: Sequence[Tensor], numbers: Sequence[Tensor]) -> None:
        """Record a visit of an image.

        Args:
            viewpoint: camera of the image.
            shown: rows (M,) of each node that the image shows.
            numbers: numbers of all rows of each node.
        """
        key = _key(viewpoint)
        record = self._records.setdefault(key, _VisitRecord())
        record.visits += 1
        if record.shown and record.visits % _FULL_EVERY == 0:
            self._bytes -= sum(bits.nbytes for bits in record.shown)
            record.shown = []
        elif not record.shown and self._bytes < MAX_BYTES:
            record.shown = [_pack_visibility(own_numbers, rows) for own_numbers, rows in zip(numbers, shown)]
            self._bytes += sum(bits.nbytes for bits in record.shown)

    def state(self) -> dict[str, Tensor]:
        """Return the records as tensors, for a checkpoint."""
        images = list(self._records.values())
        packed = [bits for image in images for bits in image.shown]
        return {
            "pictures": torch.from_numpy(np.frombuffer(b"".join(self._records), np.uint8).copy()),
            "visits": torch.tensor([image.visits for image in images], dtype=torch.int64),
            "nodes": torch.tensor([len(image.shown) for image in images], dtype=torch.int64),
            "sizes": torch.tensor([len(bits) for bits in packed], dtype=torch.int64),
            "bits": torch.from_numpy(np.concatenate([np.empty(0, np.uint8), *packed])),
        }

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned."""
        keys = state["pictures"].numpy().tobytes()
        bits = iter(np.split(state["bits"].numpy(), state["sizes"].cumsum(0).numpy()))
        self._records = {
            keys[_DIGEST * place : _DIGEST * (place + 1)]: _VisitRecord(
                visits, [next(bits).copy() for _ in range(nodes)]
            )
            for place, (visits, nodes) in enumerate(zip(state["visits"].tolist(), state["nodes"].tolist()))
        }
        self._bytes = len(state["bits"])


def _pack_visibility(numbers: Tensor, rows: Tensor) -> UInt8:
    """One bit for each row number given so far, set for those of the rows."""
    count = int(numbers[-1]) + 1 if len(numbers) else 0
    flags = np.zeros(count, np.bool_)
    flags[numbers[rows].numpy()] = True
    # The bits that fill the last byte belong to rows that will be added later: those are always decoded.
    return np.packbits(np.concatenate([flags, np.ones(-count % 8, np.bool_)]))


def _is_worth_decoding(bits: UInt8, numbers: Int64) -> Bool:
    """Return whether the bit of each number is set, or the number is newer than the bits."""
    flags = np.concatenate([np.unpackbits(bits).view(np.bool_), [True]])
    worth: Bool = flags[np.minimum(numbers, len(flags) - 1)]
    return worth


def _key(viewpoint: Viewpoint) -> bytes:
    """Key of an image: its source and its pose."""
    identity = repr(tuple(viewpoint.source)).encode() + viewpoint.viewmat.numpy().tobytes()
    return hashlib.blake2b(identity, digest_size=_DIGEST).digest()
