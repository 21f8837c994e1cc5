"""Edits that break a dataset so that one rule finds something, and but for stated consequences no other."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from mirror.schema.files import write_bytes
from tests.builders.dataset import SECOND
from tests.integrity.clean import FRAMES, Broken, TableRows

A0, A1, B2 = "a.d0.1700000000000", "a.d1.1700001000000", "b.d2.1700002000000"
B2_AGAIN = "b.d2.1700002100000"
BOXES, MASKS = f"traversals/{A0}/layers/boxes/petr@1", f"traversals/{A0}/layers/masks/sam@2.1"
DEPTH, POINTS = f"traversals/{A0}/layers/depth/sweep@1", f"traversals/{A0}/layers/points/sweep@1"
LIDARS = f"traversals/{A0}/layers/lidars/recorded@1"
RECORDED = f"traversals/{A0}/recorded"
# TableRows of the cameras in a table of images.
LEFT, RIGHT, WIDE = range(0, FRAMES), range(FRAMES, 2 * FRAMES), range(2 * FRAMES, 3 * FRAMES)
HOUR = 3600 * SECOND


@dataclass(frozen=True)
class Edit:
    """A rule's id, what breaks it, where it is found, and which other rules must follow.

    Attributes:
        rule: the rule's id.
        change: breaks it.
        file: where the finding is; None: anywhere.
        also: other rules that cannot but find something too.
        seal: whether manifests and index follow the edit, as if a faulty writer had made it.
    """

    rule: str
    change: Callable[[Broken], object]
    file: str | None = None
    also: frozenset[str] = field(default_factory=frozenset)
    seal: bool = True


def of(rule: str, change: Callable[[Broken], object], file: str | None = None, *also: str, seal: bool = True) -> Edit:
    return Edit(rule, change, file, frozenset(also), seal)


def place(broken: Broken, path: str) -> Path:
    """The file or folder at a path, in which a pattern stands for the name of the index's segment."""
    return next(iter(sorted(broken.root.glob(path))), broken.root / path) if "*" in path else broken.root / path


def put(path: str, data: bytes) -> Callable[[Broken], object]:
    return lambda broken: write_bytes(broken.root / path, data)


def drop(path: str) -> Callable[[Broken], object]:
    def change(broken: Broken) -> None:
        target = place(broken, path)
        shutil.rmtree(target) if target.is_dir() else target.unlink()

    return change


def rename(path: str, name: str) -> Callable[[Broken], object]:
    return lambda broken: (broken.root / path).rename((broken.root / path).with_name(name))


def key(path: str, **values: object) -> Callable[[Broken], object]:
    return lambda broken: broken.document(path, lambda raw: raw.update(values))


def cell(name: str, table: str, where: int | range, **values: object) -> Callable[[Broken], object]:
    return lambda broken: broken.set(name, table, where, **values)


def rows(name: str, table: str, change: Callable[[TableRows], TableRows]) -> Callable[[Broken], object]:
    return lambda broken: broken.rows(name, table, change)


def plus(column: str, amount: float) -> Callable[[dict[str, float]], float]:
    return lambda row: row[column] + amount


def cut(path: str, size: int) -> Callable[[Broken], object]:
    def change(broken: Broken) -> None:
        file = place(broken, path)
        write_bytes(file, file.read_bytes()[:size])

    return change


def image(broken: Broken, row: int, data: bytes) -> None:
    """Other bytes for an image, known to the table."""
    broken.set(A0, "images", row, byte_length=len(data), sha256=hashlib.sha256(data).digest())
    write_bytes(broken.root / broken.read(A0, "images")[row]["uri"], data)


def first_image(broken: Broken) -> str:
    return str(broken.read(A0, "images")[0]["uri"])
