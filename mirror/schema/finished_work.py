"""Finished items of a run that can be interrupted: each result is reused for the inputs that it was made from alone.

The file has a line of JSON for each item: its name, a hash of everything that its result depends on, and the result.
A name or a time stamp does not identify an item's input: the same name may have other bytes in the next run. So the
hash decides, and a result with another hash counts as not there.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, TypeVar

from mirror.errors import DatasetError
from mirror.schema.hashing import hash_document
from mirror.schema.json_lines import append_line, decode_object, read_lines

Result = TypeVar("Result")


class FinishedWork(Generic[Result]):
    """The finished items of one file.

    Args:
        path: the file; it need not exist.
        decode: makes a result of its plain values; raises `ValueError` or `KeyError` for broken ones.
        sync: whether an added item is on disk, and not in the system's memory alone, when `add` returns.

    Attributes:
        known: the hash of the inputs and the result of each finished item.

    Raises:
        DatasetError: a line is broken.
    """

    def __init__(self, path: Path, decode: Callable[[Any], Result], *, sync: bool = False) -> None:
        self._path, self._sync = path, sync
        self.known: dict[str, tuple[str, Result]] = {}

        def decode_line(line: bytes) -> None:
            row = decode_object(line)
            # A line of an earlier version states no inputs: its item is made again.
            if "inputs" in row:
                self.known[row["item"]] = row["inputs"], decode(row["result"])

        read_lines(path, decode_line)

    def find(self, item: str, hash_inputs: Callable[[], str]) -> Result | None:
        """Return the result of an item that was made from the present inputs; None if there is no such result.

        Args:
            item: name of the item.
            hash_inputs: computes the hash of the inputs; it is called only if the item has a result. Where it raises
                `DatasetError`, such as for an image that cannot be read, there is no result.
        """
        if item not in self.known:
            return None
        inputs, result = self.known[item]
        try:
            return result if inputs == hash_inputs() else None
        except DatasetError:
            # The work on the item names the fault.
            return None

    def add(self, item: str, inputs: str, plain: object, result: Result) -> None:
        """Append an item.

        Args:
            item: name of the item.
            inputs: hash of the inputs.
            plain: the result as values of JSON.
            result: what `find` returns for them.

        Raises:
            DatasetError: the file cannot be written.
        """
        append_line(self._path, json.dumps({"item": item, "inputs": inputs, "result": plain}), sync=self._sync)
        self.known[item] = inputs, result


def hash_values(*values: object) -> str:
    """Return the SHA-256 of values of JSON, in hexadecimal."""
    return hash_document(values)
