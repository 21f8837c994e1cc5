"""The contents of a file that may hold images: members of archives, cells of tables, and data of web pages."""

from __future__ import annotations

import base64
import binascii
import gzip
import io
import re
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

_DEPTH: Final = 3
"""Archives in archives are opened up to this depth."""
_SMALLEST: Final = 64
"""Cells of tables below this size are hashes, keys and geometry, and no images."""
_DATA: Final = re.compile(rb"base64,\s*([A-Za-z0-9+/=\s]{64,})")
_TEXT: Final = (b"<", b"{", b"[")


def contents(data: bytes, depth: int = _DEPTH) -> Iterator[tuple[str, bytes]]:
    """Yield the parts of a file, such as members and cells: a description of each place, and its bytes.

    A file is opened by its first bytes, whatever its name says.

    Args:
        data: bytes of the file.
        depth: how deep archives in archives are opened.

    Raises:
        ValueError: an archive or table is broken or encrypted, so that nothing states what it holds.
    """
    opener = _opener(data)
    if opener is None or depth == 0:
        return
    for place, piece in opener(data):
        yield place, piece
        for inner, more in contents(piece, depth - 1):
            yield f"{place}: {inner}", more


def _opener(data: bytes) -> Callable[[bytes], Iterator[tuple[str, bytes]]] | None:
    if data[:4] == b"PK\x03\x04":
        return _zip_members
    if data[:4] == b"PAR1":
        return _cells
    if data[:2] == b"\x1f\x8b":
        return _unzipped
    if data[257:262] == b"ustar":
        return _tar_members
    if data[:64].lstrip()[:1] in _TEXT:
        return _inlined
    return None


def _zip_members(data: bytes) -> Iterator[tuple[str, bytes]]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for name in archive.namelist():
                yield f"member {name}", archive.read(name)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, zlib.error) as error:
        raise ValueError(f"a zip archive that cannot be opened ({error})") from error


def _unzipped(data: bytes) -> Iterator[tuple[str, bytes]]:
    try:
        yield "the uncompressed bytes", gzip.decompress(data)
    except (OSError, EOFError, zlib.error) as error:
        raise ValueError(f"a compressed file that cannot be opened ({error})") from error


def _tar_members(data: bytes) -> Iterator[tuple[str, bytes]]:
    try:
        with tarfile.open(fileobj=io.BytesIO(data), mode="r:") as archive:
            for member in archive:
                opened = archive.extractfile(member) if member.isfile() else None
                if opened is not None:
                    yield f"member {member.name}", opened.read()
    except (tarfile.TarError, EOFError, OSError) as error:
        raise ValueError(f"a tar archive that cannot be opened ({error})") from error


def _cells(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Cells of the binary columns of a Parquet table, also of those in structures and lists."""
    try:
        file = pq.ParquetFile(pa.BufferReader(data))
        names = [item.name for item in file.schema_arrow if _holds_bytes(item.type)]
        for batch in file.iter_batches(64, columns=names) if names else ():
            for name, column in zip(names, batch.columns):
                for cell in column.to_pylist():
                    yield from ((f"column {name}", piece) for piece in _pieces(cell) if len(piece) >= _SMALLEST)
    except (pa.ArrowInvalid, OSError) as error:
        raise ValueError(f"a table that cannot be opened ({error})") from error


def _holds_bytes(kind: pa.DataType) -> bool:
    if pa.types.is_nested(kind):
        return any(_holds_bytes(kind.field(number).type) for number in range(kind.num_fields))
    if pa.types.is_fixed_size_binary(kind):
        return bool(kind.byte_width >= _SMALLEST)
    return bool(pa.types.is_binary(kind) or pa.types.is_large_binary(kind))


def _pieces(cell: Any) -> Iterator[bytes]:
    if isinstance(cell, bytes):
        yield cell
    elif isinstance(cell, dict):
        for value in cell.values():
            yield from _pieces(value)
    elif isinstance(cell, list):
        for value in cell:
            yield from _pieces(value)


def _inlined(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Images that a page or a JSON document holds as base64."""
    for match in _DATA.finditer(data):
        text = re.sub(rb"\s", b"", match[1])
        try:
            yield f"data at byte {match.start(1)}", base64.b64decode(text + b"=" * (-len(text) % 4))
        except binascii.Error:
            continue
