"""What each training image showed when all of it was last decoded: what was hidden is left out for a while."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.training.viewpoint import Viewpoint
from mirror.arrays import Bool, Int64, UInt8

_EVERY: Final = 4
"""One visit in so many decodes everything: what stood in front may have moved or gone."""
MAX_BYTES: Final = 1 << 26
_DIGEST: Final = 16


@dataclass
class _Visited:
    """Of an image: how often it was visited, and of each node a bit for each row of then, set where it was shown."""

    visits: int = 0
    shown: list[UInt8] = field(default_factory=list)


class VisibilityCache:
    """Which rows of the nodes each training image shows.

    Half of what a street's viewpoint may see is hidden by something: its gradients are zero, and cost what others do.
    Rows that an image did not show are left out at its next three visits; rows that are new since are not. A row costs
    a bit an image, in all no more than 64 MiB: images beyond are decoded in full.
    """

    def __init__(self) -> None:
        self._visited: dict[bytes, _Visited] = {}
        self._bytes = 0

    def select_rows(self, viewpoint: Viewpoint, seen: Sequence[Tensor], numbers: Sequence[Tensor]) -> list[Tensor]:
        """Of what a viewpoint may see that which is worth decoding.

        Args:
            viewpoint: of the image.
            seen: of each node rows (M,).
            numbers: of each node those of all its rows (N,), see `LazyAdam.numbers`.
        """
        visited = self._visited.get(_key(viewpoint))
        if visited is None or not visited.shown:
            return list(seen)
        return [
            rows[torch.from_numpy(_worth(shown, own[rows].numpy()))]
            for rows, own, shown in zip(seen, numbers, visited.shown)
        ]

    def record(self, viewpoint: Viewpoint, shown: Sequence[Tensor], numbers: Sequence[Tensor]) -> None:
        """An image was visited.

        Args:
            viewpoint: of the image.
            shown: of each node the rows (M,) that it shows.
            numbers: of each node those of all its rows.
        """
        key = _key(viewpoint)
        visited = self._visited.setdefault(key, _Visited())
        visited.visits += 1
        if visited.shown and visited.visits % _EVERY == 0:
            self._bytes -= sum(one.nbytes for one in visited.shown)
            visited.shown = []
        elif not visited.shown and self._bytes < MAX_BYTES:
            visited.shown = [_bits(own, rows) for own, rows in zip(numbers, shown)]
            self._bytes += sum(one.nbytes for one in visited.shown)

    def state(self) -> dict[str, Tensor]:
        """All that it keeps."""
        images = list(self._visited.values())
        bits = [one for image in images for one in image.shown]
        return {
            "pictures": torch.from_numpy(np.frombuffer(b"".join(self._visited), np.uint8).copy()),
            "visits": torch.tensor([image.visits for image in images], dtype=torch.int64),
            "nodes": torch.tensor([len(image.shown) for image in images], dtype=torch.int64),
            "sizes": torch.tensor([len(one) for one in bits], dtype=torch.int64),
            "bits": torch.from_numpy(np.concatenate([np.empty(0, np.uint8), *bits])),
        }

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """The opposite of `state`."""
        keys = state["pictures"].numpy().tobytes()
        bits = iter(np.split(state["bits"].numpy(), state["sizes"].cumsum(0).numpy()))
        self._visited = {
            keys[_DIGEST * place : _DIGEST * (place + 1)]: _Visited(visits, [next(bits).copy() for _ in range(nodes)])
            for place, (visits, nodes) in enumerate(zip(state["visits"].tolist(), state["nodes"].tolist()))
        }
        self._bytes = len(state["bits"])


def _bits(numbers: Tensor, rows: Tensor) -> UInt8:
    """A bit for each number that was ever given, set for those of the rows."""
    given = int(numbers[-1]) + 1 if len(numbers) else 0
    flags = np.zeros(given, np.bool_)
    flags[numbers[rows].numpy()] = True
    # Numbers that fill the last byte are given to rows that are new by then.
    return np.packbits(np.concatenate([flags, np.ones(-given % 8, np.bool_)]))


def _worth(bits: UInt8, numbers: Int64) -> Bool:
    """Of which numbers the bit is set, or none was kept yet."""
    flags = np.concatenate([np.unpackbits(bits).view(np.bool_), [True]])
    worth: Bool = flags[np.minimum(numbers, len(flags) - 1)]
    return worth


def _key(viewpoint: Viewpoint) -> bytes:
    """What tells an image from others: who took it, and from where."""
    network_inputs = repr(tuple(viewpoint.source)).encode() + viewpoint.viewmat.numpy().tobytes()
    return hashlib.blake2b(network_inputs, digest_size=_DIGEST).digest()
