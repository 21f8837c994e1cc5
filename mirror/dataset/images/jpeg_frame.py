"""The frame, the tables and the progress of a JPEG (ITU T.81), as its segments define them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from mirror.arrays import Int64, UInt8

_BITS_OF_SEQUENTIAL: Final = (0, 63, 0, 0)
_MOST_PIXELS: Final = 1 << 30


class FormatError(Exception):
    """The bytes violate the format, or use a part of the format that no camera uses."""


@dataclass
class Component:
    """A component of the frame.

    Attributes:
        identifier: its id.
        horizontal: horizontal sampling factor.
        vertical: vertical sampling factor.
        quantisation: number of its quantisation table.
        bits: (64,) position of the lowest bit of each coefficient that a scan has given; -1: none has.
        known: coefficients that are not zero, for progressive scans; None: no scan of AC coefficients came yet.
    """

    identifier: int
    horizontal: int
    vertical: int
    quantisation: int
    bits: Int64 = field(default_factory=lambda: np.full(64, -1, np.int64))
    known: UInt8 | None = None


@dataclass
class JpegFrame:
    """The frame of a JPEG: its size and its components.

    Attributes:
        progressive: whether its scans are progressive.
        width: pixels.
        height: pixels.
        components: its components.
    """

    progressive: bool
    width: int
    height: int
    components: Sequence[Component]

    @classmethod
    def parse(cls, marker: int, body: bytes) -> JpegFrame:
        """Read the body of an SOF0, SOF1 or SOF2 segment.

        Raises:
            FormatError: it is broken, or of a kind that cameras do not write.
        """
        if len(body) < 6 or len(body) != 6 + 3 * body[5] or not 1 <= body[5] <= 4:
            raise FormatError("a frame of a wrong length")
        height, width = int.from_bytes(body[1:3]), int.from_bytes(body[3:5])
        if body[0] != 8:
            raise FormatError(f"{body[0]} bits per sample")
        if not height or not width or height * width > _MOST_PIXELS:
            raise FormatError(f"{width} x {height} px in the frame")
        rows = [body[at : at + 3] for at in range(6, len(body), 3)]
        components = [Component(row[0], row[1] >> 4, row[1] & 15, row[2]) for row in rows]
        if any(not (1 <= one.horizontal <= 4 and 1 <= one.vertical <= 4) for one in components):
            raise FormatError("sampling factors that are not 1 to 4")
        if len({one.identifier for one in components}) != len(components):
            raise FormatError("two components of one id")
        return cls(marker == 0xC2, width, height, components)

    def blocks_of(self, component: Component) -> int:
        """Return the number of blocks of a component in a scan that holds it alone."""
        most_h = max(one.horizontal for one in self.components)
        most_v = max(one.vertical for one in self.components)
        wide = -(-self.width * component.horizontal // most_h)
        high = -(-self.height * component.vertical // most_v)
        return -(-wide // 8) * -(-high // 8)

    def units(self) -> int:
        """Return the number of minimum coded units of a scan of several components."""
        most_h = max(one.horizontal for one in self.components)
        most_v = max(one.vertical for one in self.components)
        return -(-self.width // (8 * most_h)) * -(-self.height // (8 * most_v))

    def is_complete(self) -> bool:
        """Return whether the scans so far give every bit of every coefficient, so that the image is complete."""
        return all((one.bits == 0).all() for one in self.components)


@dataclass(frozen=True)
class ScanHeader:
    """The header of a scan.

    Attributes:
        components: its components with the numbers of their tables of DC and AC coefficients.
        first: first coefficient.
        last: last coefficient.
        high: position of the lowest bit that was given before; 0: none was.
        low: position of the lowest bit that this scan gives.
    """

    components: Sequence[tuple[Component, int, int]]
    first: int
    last: int
    high: int
    low: int

    @classmethod
    def parse(cls, body: bytes, frame: JpegFrame) -> ScanHeader:
        """Read the body of an SOS segment.

        Raises:
            FormatError: it is broken, or repeats what an earlier scan has given.
        """
        if len(body) < 4 or len(body) != 4 + 2 * body[0] or not 1 <= body[0] <= len(frame.components):
            raise FormatError("a scan with a header of a wrong length")
        by_id = {one.identifier: one for one in frame.components}
        pairs = [body[at : at + 2] for at in range(1, 1 + 2 * body[0], 2)]
        if len({pair[0] for pair in pairs}) != len(pairs) or not {pair[0] for pair in pairs} <= set(by_id):
            raise FormatError("a scan of an unknown component")
        first, last, high, low = body[-3], body[-2], body[-1] >> 4, body[-1] & 15
        if not frame.progressive:
            # Decoders do not read these of a sequential frame.
            first, last, high, low = _BITS_OF_SEQUENTIAL
        scan = cls([(by_id[one], tables >> 4, tables & 15) for one, tables in pairs], first, last, high, low)
        if any(dc > 3 or ac > 3 for _, dc, ac in scan.components):
            raise FormatError("a table above number 3")
        scan._advance(frame)
        return scan

    def _advance(self, frame: JpegFrame) -> None:
        """Note which bits the scan gives.

        Raises:
            FormatError: they are not the next ones, such as those that an earlier scan gave.
        """
        if frame.progressive:
            is_dc = self.first == 0
            if not (self.first <= self.last < 64) or self.low > 13 or (is_dc and self.last != 0):
                raise FormatError("a scan of coefficients that do not exist")
            if not is_dc and len(self.components) != 1:
                raise FormatError("a scan of AC coefficients of several components")
            if self.high and self.low != self.high - 1:
                raise FormatError("a scan that leaves out a bit")
        for component, _, _ in self.components:
            if self.first > 0 and component.bits[0] < 0:
                raise FormatError("a scan of AC coefficients before that of DC")
            wanted = self.high if self.high else -1
            if (component.bits[self.first : self.last + 1] != wanted).any():
                raise FormatError("a scan that repeats what an earlier one gave")
            component.bits[self.first : self.last + 1] = self.low
