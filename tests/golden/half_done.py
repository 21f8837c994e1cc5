"""A dataset with the unfinished work of several verbs, as MIRROR 0.1.0 left it: ``half_done.zip``.

``python -m tests.golden.half_done`` writes it again. Beside it stands what each layer was made from once the verbs have
finished: the inputs of a layer decide whether it is made again, so today's code must state the same.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import zipfile
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import cv2
import numpy as np

import mirror
from mirror.annotation import annotate
from mirror.annotation.descriptions import Description, describe_frames
from mirror.annotation.masks import MaskOptions, mask_layer
from mirror.annotation.tracking.layer import track_layer
from mirror.dataset.frames import Frame
from mirror.dataset.index.build import build_index
from tests.annotation.known import Known
from tests.builders.dataset import Builder, Pass
from tests.interruption import interrupting

DATASET: Final = Path(__file__).with_name("half_done.zip")
RECORD: Final = Path(__file__).with_name("half_done.json")


@dataclass
class Words:
    """Describes frames."""

    calls: int = 0
    fingerprint: str = field(default="words 1", init=False)

    def describe(self, frame: Frame) -> Description:
        self.calls += 1
        return Description(f"{frame.traversal_id} {frame.frame_index}", "day", None)

    def close(self) -> None:
        pass


def main() -> None:
    """Write the dataset, and the inputs of its layers once they are finished."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "dataset"
        _write(root)
        with zipfile.ZipFile(DATASET, "w", zipfile.ZIP_DEFLATED) as file:
            for path in sorted(path for path in root.parent.rglob("*") if path.is_file()):
                name = zipfile.ZipInfo(path.relative_to(root.parent).as_posix())
                file.writestr(name, path.read_bytes(), zipfile.ZIP_DEFLATED)
        finish(root)
        RECORD.write_text(json.dumps(layer_inputs(root), indent=1) + "\n")


def unpack(folder: Path) -> Path:
    """Unpack the dataset, and the unfinished file of descriptions beside it, into an empty folder."""
    with zipfile.ZipFile(DATASET) as file:
        file.extractall(folder)
    return folder / "dataset"


def finish(root: Path) -> dict[str, tuple[int, int]]:
    """Run the verbs again.

    Returns:
        How much each took from the run before, and how much it did.
    """
    annotator, describer = Known(), Words()
    found = annotate(mirror.open(root), annotator)
    tracks, masks = track_layer(mirror.open(root), "other@1"), mask_layer(mirror.open(root), "other@1", MaskOptions())
    # Last, because a description depends on all layers of boxes.
    described = describe_frames(mirror.open(root), describer, root.parent / "words.jsonl")
    return {
        "annotate": (len(found.kept) + found.resumed, annotator.calls),
        "describe": (described.kept, describer.calls),
        "track": (len(tracks.kept), len(tracks.written)),
        "masks": (len(masks.kept), len(masks.written)),
    }


def layer_inputs(root: Path) -> dict[str, dict[str, str]]:
    """List what each layer states that it was made from."""
    manifests = sorted(root.glob("traversals/*/layers/*/*/manifest.json"))
    return {
        path.parent.relative_to(root / "traversals").as_posix(): json.loads(path.read_text())["derived_from"]
        for path in manifests
    }


def _write(root: Path) -> None:
    builder = Builder(root, cameras=("front_wide", "rear"))
    builder.scene("a")
    image = cv2.imencode(".jpg", np.full((32, 48, 3), 90, np.uint8))[1].tobytes()
    builder.drive("d0", [Pass("a", frames=4, images={"front_wide": image, "rear": image})])
    builder.drive("d1", [Pass("a", frames=3, heading_deg=200.0, images={"front_wide": image, "rear": image})])
    build_index(root)
    annotate(mirror.open(root), Known(), source="other")
    track_layer(mirror.open(root), "other@1")
    mask_layer(mirror.open(root), "other@1", MaskOptions())
    # As if the process was killed after the layers of the first traversal.
    (second,) = root.glob("traversals/*d1*")
    for layer in ("boxes/other-tracks@1", "masks/other-hulls@1"):
        shutil.rmtree(second / "layers" / layer)
    build_index(root)
    with suppress(KeyboardInterrupt):
        annotate(mirror.open(root), interrupting(Known(), "annotate", 6))
    with suppress(KeyboardInterrupt):
        describe_frames(mirror.open(root), interrupting(Words(), "describe", 4), root.parent / "words.jsonl")


if __name__ == "__main__":
    main()
