"""Searches files for a secret in all its spellings."""

from __future__ import annotations

import base64
import zipfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq

_WIDTHS = (16, 17)


def spellings(secret: int) -> dict[str, bytes]:
    """The spellings of a secret number, by name: decimal, hexadecimal, binary, base64 in all three alignments."""
    found: dict[str, bytes] = {}
    for name, number in (("", secret), ("random bits, ", secret % (1 << 128))):
        text = f"{number:x}"
        found |= {
            f"{name}decimal": str(number).encode(),
            f"{name}hex": text.encode(),
            f"{name}HEX": text.upper().encode(),
        }
        for width, order in ((w, o) for w in _WIDTHS for o in ("big", "little") if number < 1 << 8 * w):
            data = number.to_bytes(width, order)  # type: ignore[arg-type]
            found[f"{name}{width} bytes, {order}-endian"] = data
            for shift in range(3):
                # The letters that do not depend on the neighbours.
                letters = base64.b64encode(b"\0" * shift + data)
                found[f"{name}base64 of {width} bytes, {order}-endian, shift {shift}"] = letters[4 * (shift > 0) : -4]
    # The halves, as they would stand in 64-bit columns.
    for place, half in enumerate((secret % (1 << 64), secret >> 64 & (1 << 64) - 1)):
        found |= {f"half {place}, decimal": str(half).encode(), f"half {place}, binary": half.to_bytes(8, "little")}
    return found


def contents(path: Path) -> Iterator[bytes]:
    """The bytes of a file, and what is compressed in it: Parquet columns, entries of archives, pixels of PNGs."""
    data = path.read_bytes()
    yield data
    if data[:4] == b"PAR1":
        table = pq.read_table(path)
        yield repr(table.schema.metadata).encode()
        for column in table.columns:
            yield repr(column.to_pylist()).encode()
            yield from (buffer.to_pybytes() for chunk in column.chunks for buffer in chunk.buffers() if buffer)
    elif data[:4] == b"PK\3\4":
        with zipfile.ZipFile(path) as archive:
            yield from (archive.read(name) for name in archive.namelist())
    elif data[:4] == b"\x89PNG":
        yield cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED).tobytes()


def find_secrets(folder: Path, secrets: dict[str, int]) -> list[str]:
    """Search the names and contents of all files below a folder; one line for each that has a spelling of a secret."""
    needles = {f"{what}, {how}": text for what, secret in secrets.items() for how, text in spellings(secret).items()}
    found = []
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        blobs = [name.encode(), *(contents(path) if path.is_file() else ())]
        found += [f"{name}: {what}" for what, text in needles.items() if any(text in blob for blob in blobs)]
    return found
