"""The files of an index whose newest snapshot has one segment."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import mirror
from mirror.schema.files import write_bytes
from mirror.schema.index_tables import INDEX_BY_SCENE, INDEX_GLOBAL, ROW_GROUPS


def newest_snapshot(root: Path) -> Path:
    """The file of a dataset's newest snapshot."""
    return max(root.glob("index/snapshots/*.json"))


def segment_names(root: Path) -> list[str]:
    """The names of the segments of a dataset's newest snapshot."""
    return [one["name"] for one in json.loads(newest_snapshot(root).read_text())["segments"]]


def segment_folder(root: Path) -> Path:
    """The folder of the only segment of a dataset's newest snapshot."""
    (name,) = segment_names(root)
    return root / "index" / name


def tamper(root: Path, change: dict[str, bytes]) -> None:
    """Give files of the only segment other bytes, with hashes that agree."""
    folder, snapshot = segment_folder(root), newest_snapshot(root)
    manifest = json.loads((folder / "manifest.json").read_text())
    for name, data in change.items():
        write_bytes(folder / name, data)
        manifest["files"][name] = {"bytes": len(data), "sha256": sha256(data)}
    write_bytes(folder / "manifest.json", json.dumps(manifest).encode())
    document = json.loads(snapshot.read_text())
    document["segments"][0]["manifest"] = sha256((folder / "manifest.json").read_bytes())
    write_bytes(snapshot, json.dumps(document).encode())


def sha256(data: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def tables_of(root: Path) -> dict[str, list[dict[str, object]]]:
    """All rows that a reader sees, by table; row groups have numbers by file."""
    dataset = mirror.open(root)
    tables = [table for table in (*INDEX_GLOBAL, *INDEX_BY_SCENE) if table is not ROW_GROUPS]
    return {table.name: dataset.table(table.name).to_pylist() for table in tables}
