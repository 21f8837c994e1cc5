"""Damages a recording: one random change of one of its files, of the kinds that occur in users' recordings."""

from __future__ import annotations

import json
import lzma
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.feather as feather
import pyarrow.parquet as pq

NUMBERS = ("1e308", "-1e308", "1e400", "99999999999999999999", "9223372036854775807", "-1", "0", "5e-324", "1e15")
NO_NUMBERS = ("nan", "NaN", "inf", "-inf", "", "null", "[/b]", "x" * 70_000, "\x00", "\N{SNOWMAN}")
_NUMBER = re.compile(rb"-?[0-9]+(?:\.[0-9]+)?(?:[eE][-+]?[0-9]+)?")
# Of a large image: it has a match in every 15 bytes.
_SEARCHED_BYTES = 2**18
_COLUMNAR = (".parquet", ".feather")
_TEXTS = (".csv", ".json", ".txt")

Generator = np.random.Generator
Mutation = Callable[[Path, Path, Generator], None]


def _replace(file: Path, data: bytes) -> None:
    """Replace a file by new bytes; the file may be a hard link to the pristine file."""
    file.unlink()
    file.write_bytes(data)


def _is_array(file: Path) -> bool:
    return file.read_bytes()[:6] == b"\x93NUMPY"


def flip_bits(root: Path, file: Path, random: Generator) -> None:
    """Flip one to eight bits anywhere."""
    data = bytearray(file.read_bytes())
    for _ in range(int(random.integers(1, 9))):
        data[int(random.integers(len(data)))] ^= 1 << int(random.integers(8))
    _replace(file, bytes(data))


def flip_header(root: Path, file: Path, random: Generator) -> None:
    """Change bytes of the first 128, where formats have their header."""
    data = bytearray(file.read_bytes())
    for _ in range(int(random.integers(1, 4))):
        data[int(random.integers(min(128, len(data))))] = int(random.integers(256))
    _replace(file, bytes(data))


def truncate(root: Path, file: Path, random: Generator) -> None:
    """Truncate the file anywhere."""
    data = file.read_bytes()
    _replace(file, data[: int(random.integers(len(data)))])


def empty(root: Path, file: Path, random: Generator) -> None:
    """Remove all bytes."""
    _replace(file, b"")


def remove(root: Path, file: Path, random: Generator) -> None:
    """Remove the file."""
    file.unlink()


def swap(root: Path, file: Path, random: Generator) -> None:
    """Swap the contents of the file and another file."""
    files = sorted(path for path in root.rglob("*") if path.is_file() and path != file)
    if files:
        other = files[int(random.integers(len(files)))]
        here, there = file.read_bytes(), other.read_bytes()
        _replace(file, there)
        _replace(other, here)


def put_number(root: Path, file: Path, random: Generator) -> None:
    """Replace one of the file's numbers by a huge, tiny or negative number, or by a text that is not a number."""
    words = NUMBERS if random.random() < 0.5 else NO_NUMBERS
    word = words[int(random.integers(len(words)))]
    if file.suffix in _COLUMNAR:
        _change_cell(file, word, random)
    elif _is_array(file):
        array = np.load(file)
        value = float(word) if word in NUMBERS else (np.nan, np.inf, -np.inf)[int(random.integers(3))]
        array[tuple(int(random.integers(size)) for size in array.shape)] = value
        _save(file, array)
    else:
        data = file.read_bytes()
        begin = int(random.integers(len(data) - _SEARCHED_BYTES)) if len(data) > _SEARCHED_BYTES else 0
        numbers = list(_NUMBER.finditer(data, begin, begin + _SEARCHED_BYTES))
        if numbers:
            number = numbers[int(random.integers(len(numbers)))]
            _replace(file, data[: number.start()] + word.encode() + data[number.end() :])


def _change_cell(file: Path, word: str, random: Generator) -> None:
    table = _read_table(file)
    name = table.column_names[int(random.integers(table.num_columns))]
    values = table.column(name).to_pylist()
    row = int(random.integers(len(values)))
    kind = table.schema.field(name).type
    if pa.types.is_floating(kind):
        values[row] = float(word) if word in NUMBERS else float("nan")
    elif pa.types.is_integer(kind):
        largest = 2 ** min(kind.bit_width - 2, 62)
        values[row] = (0 if pa.types.is_unsigned_integer(kind) else -1, largest, None)[int(random.integers(3))]
    elif pa.types.is_nested(kind):
        values[row] = None
    else:
        values[row] = word
    _write_table(file, table.set_column(table.column_names.index(name), name, pa.array(values, kind)))


def _read_table(file: Path) -> pa.Table:
    return feather.read_table(file, memory_map=False) if file.suffix == ".feather" else pq.read_table(file)


def _write_table(file: Path, table: pa.Table) -> None:
    file.unlink()
    if file.suffix == ".feather":
        feather.write_feather(table, file)
    else:
        pq.write_table(table, file)


def _save(file: Path, array: np.ndarray) -> None:
    file.unlink()
    with file.open("wb") as out:
        np.save(out, array)


def change_columns(root: Path, file: Path, random: Generator) -> None:
    """Repeat, remove or rename a column, key or axis."""
    how = int(random.integers(3))
    if file.suffix in _COLUMNAR:
        table = _read_table(file)
        at = int(random.integers(table.num_columns))
        name = table.column_names[at]
        if how == 0:
            table = table.append_column(name, table.column(at))
        elif how == 1:
            table = table.remove_column(at)
        else:
            table = table.rename_columns([f"{n}[b]" if n == name else n for n in table.column_names])
        _write_table(file, table)
    elif file.suffix == ".csv":
        rows = [line.split(",") for line in file.read_text().splitlines()]
        at = int(random.integers(len(rows[0])))
        if how == 2:
            rows[0][at] = ("[/red]", rows[0][at].upper(), "", rows[0][at] + " ")[int(random.integers(4))]
        else:
            rows = [[*row, row[at]] if how == 0 else row[:at] + row[at + 1 :] for row in rows]
        _replace(file, "".join(",".join(row) + "\n" for row in rows).encode())
    elif file.suffix == ".json":
        document = json.loads(file.read_text())
        key_of = _random_object(document, random)
        if key_of:
            key = sorted(key_of)[int(random.integers(len(key_of)))]
            value = key_of.pop(key)
            if how != 1:
                key_of["[b]" if how == 2 else f"{key}\ud83d"] = value
        text = json.dumps(document)
        _replace(file, (text.replace("\\ud83d", "") if how == 0 else text).encode())
    elif _is_array(file):
        array = np.load(file)
        _save(file, (array[:, :-1], np.concatenate([array, array], axis=1), array.ravel())[how])
    else:
        flip_header(root, file, random)


def _random_object(document: Any, random: Generator) -> dict[str, Any] | None:
    """Choose one of the objects in a document."""
    objects: list[dict[str, Any]] = []
    pending = [document]
    while pending:
        value = pending.pop()
        if isinstance(value, dict):
            objects.append(value)
            pending += value.values()
        elif isinstance(value, list):
            pending += value
    objects = [candidate for candidate in objects if candidate]
    return objects[int(random.integers(len(objects)))] if objects else None


def change_type(root: Path, file: Path, random: Generator) -> None:
    """Replace a JSON value by another type or by nesting beyond any parser's depth; change the type of an array."""
    if file.suffix == ".json":
        document = json.loads(file.read_text())
        owner = _random_object(document, random)
        if owner is not None:
            key = sorted(owner)[int(random.integers(len(owner)))]
            others: tuple[Any, ...] = (None, True, -1, 1.5, "[/b]", [], {}, [[1]], {"a": 1}, "../../x", "DEEP")
            owner[key] = others[int(random.integers(len(others)))]
        _replace(file, json.dumps(document).replace('"DEEP"', "[" * 100_000 + "]" * 100_000).encode())
    elif _is_array(file):
        kinds = ("<f4", "<i8", "<c16", "|b1", "<U8", "|S4", "<M8[s]", ">f8")
        _save(file, np.load(file).astype(kinds[int(random.integers(len(kinds)))]))
    else:
        flip_bits(root, file, random)


def change_rows(root: Path, file: Path, random: Generator) -> None:
    """Repeat, reverse, remove or truncate rows."""
    how = int(random.integers(4))
    if file.suffix in (".csv", ".txt"):
        lines = file.read_bytes().splitlines(keepends=True)
        head, rows = lines[:1], lines[1:]
        at = int(random.integers(len(rows)))
        torn = [*rows[:at], rows[at][: len(rows[at]) // 2] + b"\n", *rows[at + 1 :]]
        _replace(file, b"".join(head + [rows + rows, rows[::-1], rows[:at] + rows[at + 30 :], torn][how]))
    elif _is_array(file):
        array = np.load(file)
        at = int(random.integers(len(array)))
        _save(file, (np.concatenate([array, array]), array[::-1], np.delete(array, at, axis=0), array[:0])[how])
    elif file.suffix in _COLUMNAR:
        table = _read_table(file)
        tables = (pa.concat_tables([table, table]), table.take(list(range(len(table)))[::-1]), table[1:], table[:0])
        _write_table(file, tables[how])
    else:
        truncate(root, file, random)


def link(root: Path, file: Path, random: Generator) -> None:
    """Replace the file by a link that leads outside, to a device, to itself or to nothing."""
    kept = file.read_bytes()
    file.unlink()
    outside = root.parent / "outside"
    outside.write_bytes(kept)
    targets = (str(outside), "/dev/zero", file.name, "nothing", "..")
    file.symlink_to(targets[int(random.integers(len(targets)))])


def pipe(root: Path, file: Path, random: Generator) -> None:
    """Replace the file by a pipe without a writer."""
    file.unlink()
    os.mkfifo(file)


def folder(root: Path, file: Path, random: Generator) -> None:
    """Replace the file by a folder."""
    file.unlink()
    file.mkdir()


def huge_header(root: Path, file: Path, random: Generator) -> None:
    """Write a header that claims more bytes than exist; without a header, write random bytes in the middle."""
    data = file.read_bytes()
    if _is_array(file):
        rows = (10**10, 2**40, 2**62, 10**30)[int(random.integers(4))]
        text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({rows}, 3), }}".ljust(117)[:117] + "\n"
        _replace(file, b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + data[128:])
    elif data[:8] == b"\x89PNG\r\n\x1a\n":
        _replace(file, data[:16] + (2**31 - 1).to_bytes(4, "big") * 2 + data[24:])
    elif data[:2] == b"\xff\xd8":
        at = data.index(b"\xff\xc0")
        _replace(file, data[: at + 5] + b"\xff\xff\xff\xff" + data[at + 9 :])
    else:
        middle = len(data) // 2
        _replace(file, data[:middle] + random.bytes(64) + data[middle + 64 :])


MUTATIONS: dict[str, Mutation] = {
    "flip_bits": flip_bits,
    "flip_header": flip_header,
    "truncate": truncate,
    "empty": empty,
    "remove": remove,
    "swap": swap,
    "put_number": put_number,
    "change_columns": change_columns,
    "change_type": change_type,
    "change_rows": change_rows,
    "link": link,
    "pipe": pipe,
    "folder": folder,
    "huge_header": huge_header,
}


def mutate(root: Path, random: Generator) -> tuple[str, Path]:
    """Damage one file of a recording, and return the name of the mutation and the file.

    Each kind of file has the same probability, whatever the number of its files; numbers are changed most often.
    """
    files: dict[tuple[Path, str], list[Path]] = {}
    for file in sorted(path for path in root.rglob("*") if path.is_file()):
        alike = len(list(file.parent.iterdir())) > 5
        files.setdefault((file.parent, file.suffix if alike else file.name), []).append(file)
    kinds = sorted(files)
    chosen = files[kinds[int(random.integers(len(kinds)))]]
    file = chosen[int(random.integers(len(chosen)))]
    names = [*MUTATIONS, "put_number", "put_number", "change_columns", "change_type"]
    name = names[int(random.integers(len(names)))]
    if file.name.endswith(".cbor.xz") and name in ("put_number", "change_columns", "change_type"):
        _change_compressed(MUTATIONS[name], root, file, random)
    else:
        MUTATIONS[name](root, file, random)
    return name, file


def _change_compressed(change: Mutation, root: Path, file: Path, random: Generator) -> None:
    """Apply a change of a JSON document to one that is stored as compressed CBOR."""
    import cbor2

    document = file.with_name("document.json")
    document.write_text(json.dumps(cbor2.loads(lzma.decompress(file.read_bytes()))))
    change(root, document, random)
    text = document.read_bytes()
    document.unlink()
    try:
        _replace(file, lzma.compress(cbor2.dumps(json.loads(text))))
    except (ValueError, RecursionError):
        _replace(file, lzma.compress(text))
