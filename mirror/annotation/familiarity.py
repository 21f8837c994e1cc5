"""Training data of an annotator, and frames that do not look like it: a document beside a layer of boxes."""

from __future__ import annotations

from typing import Final, Literal

from mirror.dataset.dataset import Dataset
from mirror.schema.documents import Document

NAME: Final = "training_data.json"


class TrainingData(Document):
    """``training_data.json`` of a layer of boxes: the data that its annotator was trained on.

    Attributes:
        format: always ``mirror-annotator-training-data``.
        version: version of this document.
        trained_on: what the annotator was trained on.
        frames: number of frames of the traversal that were annotated.
        unfamiliar_ns: times of the frames whose images do not look like those, ascending.
    """

    format: Literal["mirror-annotator-training-data"] = "mirror-annotator-training-data"
    version: Literal["1"] = "1"
    trained_on: str
    frames: int
    unfamiliar_ns: tuple[int, ...]

    def encode(self) -> bytes:
        """Return the bytes of the document."""
        return (self.model_dump_json(indent=1) + "\n").encode()


def read_training_data(dataset: Dataset, layer: str) -> dict[str, TrainingData]:
    """Read the training data that the annotator of a layer states, by traversal; empty without a statement.

    Args:
        dataset: a view; traversals without the layer are left out.
        layer: ``source@version`` of a layer of boxes.

    Raises:
        SchemaError: a document is broken.
    """
    found = {}
    rows = dataset.table("traversals", ["traversal_id", "layers"]).to_pylist()
    for traversal in [row["traversal_id"] for row in rows if f"boxes/{layer}" in row["layers"]]:
        folder = f"traversals/{traversal}/layers/boxes/{layer}"
        if NAME in dataset.store.list_files(folder):
            found[traversal] = dataset.store.json(f"{folder}/{NAME}", TrainingData)
    return found


def describe_training_data(name: str, trained_on: str, unfamiliar: int, frames: int) -> str:
    """Describe an annotator's training data, and count the frames that do not look like it."""
    text = f"{name} was trained on {trained_on}"
    if not unfamiliar:
        return f"{text}; all {frames} frames look like that"
    return f"{text}; {unfamiliar} of {frames} frames do not look like that: do not rely on their boxes"
