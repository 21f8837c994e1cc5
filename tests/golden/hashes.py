"""Hashes and bytes of documents that are made from literals alone: the same on every machine and with every package.

``python -m tests.golden.hashes`` writes those of the code at hand to ``hashes.json``. A hash in it identifies data that
users have: it changes only with the format that it belongs to.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Any, Final

from mirror.annotation.descriptions import ProgramDescriber
from mirror.annotation.subprocess_annotator import SubprocessAnnotator
from mirror.dataset.layout import Layout
from mirror.dataset.splits.split import hash_manifests
from mirror.evaluation.result import Result
from mirror.ingest.request import IngestOptions
from mirror.ingest.rois import parse_roi
from mirror.ingest.settings import merge_settings
from mirror.privacy.log import DetectorRecord
from mirror.privacy.options import DeidentifyOptions, detection_hash
from mirror.privacy.release.document import Release, Tombstone
from mirror.protocols.document import load_protocol, protocol_names
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView
from mirror.schema.bundle import Bundle
from mirror.schema.documents import (
    FileEntry,
    ImageTotals,
    Manifest,
    NovelTraversal,
    SplitDocument,
)
from mirror.schema.files import write_json
from mirror.schema.finished_work import FinishedWork, hash_values
from mirror.schema.folders import FolderKind
from mirror.schema.hashing import hash_document
from mirror.schema.render_folder import start_render_folder
from mirror.schema.rollout import Rollout
from mirror_leaderboard.boards import Board
from mirror_leaderboard.entry import Figure, Measured, Paper, Reported
from mirror_leaderboard.trust import hash_reported
from tests.leaderboard.results import result

RECORD: Final = Path(__file__).parent / "hashes.json"
_WORD: Final = "Straße, 北 \u00e9"
"""Text whose bytes differ with the escaping of a style."""
_FILE: Final = FileEntry(bytes=7, sha256="0a" * 32)


def main() -> None:
    """Write the record."""
    with tempfile.TemporaryDirectory() as folder:
        RECORD.write_text(json.dumps(dict(list_hashes(Path(folder))), indent=1) + "\n")


def list_hashes(folder: Path) -> Iterator[tuple[str, str]]:
    """List names and hashes.

    Args:
        folder: an empty folder, to write to.
    """
    yield from _hash_properties()
    yield from _hash_functions(folder)
    for name, document in _documents().items():
        file = folder / f"{name}.json"
        write_json(file, document)
        yield f"bytes of {name}", hashlib.sha256(file.read_bytes()).hexdigest()


def _hash_properties() -> Iterator[tuple[str, str]]:
    for name in protocol_names():
        yield f"protocol {name}", load_protocol(name).hash
    documents = _documents()
    yield "manifest", documents["manifest"].content
    yield "rollout", documents["rollout"].hash
    yield "rollout with a source of its map", documents["rollout"].model_copy(update={"map_source": "dataset"}).hash
    yield "result", documents["result"].hash
    yield "plan", _plan().hash
    yield "entry", documents["entry"].content_hash
    yield "entry, verified", documents["entry"].model_copy(update={"verified": True}).content_hash
    yield "reported entry", hash_reported(documents["reported"])
    yield "board", _board(documents["entry"]).id


def _hash_functions(folder: Path) -> Iterator[tuple[str, str]]:
    yield "values", hash_values("a", {"b": 1, "a": [None, 0.5, True]}, _WORD)
    yield "traversals of a split", hash_manifests({"b": "1" * 64, "a": "2" * 64, _WORD: "3" * 64})
    yield "declaration", hash_document({"b": [1, 2.5], "a": {"text": _WORD, "none": None}})
    for kind, settings in ((FolderKind.SUBMISSION, ["a", _WORD]), (FolderKind.GENERATED, ["--seed", "1"])):
        start_render_folder(folder / kind.name, settings, kind=kind)
        (mark,) = (folder / kind.name).iterdir()
        yield f"mark {mark.name}", mark.read_text()
    command = ["python", "-c", f"print('{_WORD}')"]
    yield "annotator, subprocess", SubprocessAnnotator(command, 1.0, "subprocess").fingerprint
    yield "describer, subprocess", ProgramDescriber(command, 1.0).fingerprint
    rois = [parse_roi("8.5,47.4")]
    for name, options in (("default", IngestOptions()), ("missing images", IngestOptions(max_missing_images=0.25))):
        yield f"ingest, {name}", merge_settings(Layout(folder / "new"), options, rois).configuration
    detectors = [DetectorRecord(kind="face", name="n", version="1", weights_sha256="1" * 64, threshold=0.25)]
    yield "detection", detection_hash(detectors, DeidentifyOptions())
    finished = FinishedWork(folder / "finished.jsonl", lambda plain: plain)
    finished.add("item", hash_values(1, _WORD), {"b": _WORD, "a": 1}, None)
    yield "bytes of finished work", hashlib.sha256((folder / "finished.jsonl").read_bytes()).hexdigest()


def _documents() -> dict[str, Any]:
    """A document of each kind that identifies something by its hash, or that a release or a bundle consists of."""
    protocol = load_protocol("static-reconstruction")
    return {
        "manifest": Manifest(
            derived_from={"b": "1" * 64, "a": "2" * 64},
            files={"b.parquet": _FILE, "a/ü.json": FileEntry(bytes=0, sha256="0b" * 32)},
            pictures=ImageTotals(count=2, bytes=9),
        ),
        "split": SplitDocument(
            name="novel",
            parameters=NovelTraversal(train=1, held_out=1),
            seed=3,
            scenes=None,
            dataset_hash="4" * 64,
            manifests={"a": "1" * 64, "b": "2" * 64},
            assignments={"a": "train", "b": "held_out"},
        ),
        "protocol": protocol,
        "rollout": Rollout(
            scene_id="s",
            scenario=_WORD,
            scenario_version=1,
            policy="idm",
            world="exact",
            seed=1,
            rate_hz=10.0,
            steps=3,
            ending="duration",
            route_m=((0.0, 0.1), (1e-7, 3.0)),
            versions={"mirror": "0"},
            files={"states.parquet": _FILE},
        ),
        "result": Result.model_validate(result()),
        "entry": _measured(),
        "reported": _reported(),
        "bundle": Bundle(
            split="novel",
            protocols=("static-reconstruction",),
            dataset_hash="5" * 64,
            licence="CC-BY-4.0",
            files={"dataset.json": _FILE},
            withheld=("a.jpg",),
        ),
        "release": Release(
            name="r",
            contact="a@b.example",
            tombstones=(Tombstone(item="t", version=2, reason=_WORD),),
            plate_region="CN",
        ),
    }


def _plan() -> Plan:
    views = [
        RenderView(
            path=f"renders/novel/t/front_wide/{stamp}.png", group="novel", scene_id="s", traversal_id="t",
            frame_index=0, camera="front_wide", timestamp_ns=stamp, light="day", weather="clear", model="pinhole",
            width_px=8, height_px=4, fx_px=8.0, fy_px=8.0, cx_px=4.0, cy_px=2.0, distortion=(),
            world_SE3_camera=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), edits=(),
        )
        for stamp in (1, 2)
    ]  # fmt: skip
    layers = {"t": ("boxes/file@1", "sky:masks/synth@1"), "a": ()}
    return Plan(load_protocol("static-reconstruction"), "novel", "6" * 64, layers, tuple(views), ("empty",))


def _measured() -> Measured:
    protocol = load_protocol("static-reconstruction")
    return Measured(
        method="a method",
        version="3",
        protocol=protocol.name,
        protocol_version=protocol.version,
        protocol_hash=protocol.hash,
        dataset="a street",
        dataset_hash="7" * 64,
        plan_hash="8" * 64,
        split="novel",
        options={"extractor": "rectangles"},
        result_hash="9" * 64,
        toolkit="0.1.0",
        figures=(Figure(group="novel", metric="psnr", value=20.125, low=19.0, high=21.5, n=4),),
        added=date(2026, 1, 2),
    )


def _reported() -> Reported:
    paper = Paper(
        title="A paper", table=6, label="tab:a", row="Ours", url="https://example.org/a", date="2025-11", about="PSNR"
    )
    figures = (Figure(group="all", metric="psnr", value=25.5),)
    return Reported(method="a method", protocol="static-reconstruction", dataset=None, paper=paper, figures=figures)


def _board(entry: Measured) -> Board:
    hashes = (entry.protocol_hash, entry.dataset_hash, "8" * 64)
    return Board(entry.protocol, "A street", entry.split, hashes, tuple(entry.options.items()), (entry,), ())


if __name__ == "__main__":
    main()
