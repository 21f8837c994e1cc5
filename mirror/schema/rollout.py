"""``run.json``: what a rollout was made from and how it ended. Without it, a rollout is not complete."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field

from mirror.errors import DatasetError
from mirror.schema.documents import Document, FileEntry
from mirror.schema.files import read_json, sha256_bytes
from mirror.schema.hashing import HashStyle, hash_document

ROLLOUT: Final = "run.json"
STATES_FILE: Final = "states.parquet"
SCENARIO_FILE: Final = "scenario.toml"
MAP_FILE: Final = "map.parquet"
REQUIRED_FILES: Final = (STATES_FILE, SCENARIO_FILE, MAP_FILE)
"""Files of every rollout, beside ``run.json``. Images and videos are optional."""

World = Literal["exact", "reconstructed", "generated", "boxes"]
"""The source of the images: the synthetic street, a trained model, a generative model, or wireframes of boxes."""
Ending = Literal["duration", "collision", "route_end", "left_street", "off_road", "policy", "deadline", "interrupted"]
"""The reason of a rollout's end: its time was over; the ego touched an agent; it came to the end of its route; it left
the part of the street that can be rendered; in a suite, its whole body left the drivable area; the policy failed; the
policy was too slow; the user interrupted it."""
BY_POLICY: Final = ("policy", "deadline")
"""Endings that a policy causes by its program, not by its driving."""
MapSource = Literal["synthetic", "file", "dataset", "fitted"]
"""The source of the road map: the synthetic street; a file that the user named; the recorded map of the dataset; fitted
to the driven lines of the recordings."""
Number = Annotated[float, Field(allow_inf_nan=False)]


class Rollout(Document):
    """``run.json``: the document of one rollout.

    Attributes:
        format: always ``mirror-rollout``.
        version: version of this document's format.
        scene_id: the scene.
        scenario: name of the scenario.
        scenario_version: its version.
        policy: name or address of the policy.
        policy_hash: hash of the policy's weights or code, if it has one.
        world: what rendered the images.
        model_hash: hash of the model that rendered, if there is one.
        dataset_hash: hash of the dataset that was driven in, if there is one.
        map_source: where the road map is from; None: not stated.
        seed: seed of the rollout.
        rate_hz: steps in a second.
        steps: number of steps driven; the log has one instant more.
        ending: why it ended.
        reason: an explanation of the ending, for instance the policy's error.
        route_m: points (x, y) of the ego's route in the scene's frame, in order.
        threads: number of threads of the renderer; None: nothing was rendered.
        sensors: name of the fault of the sensors, as the suite has it; None: they had none. The hash omits None.
        views: what became of the views of a drive with generated road users; None: all are rendered alike.
        versions: versions of the toolkit and of packages that affect the rollout.
        files: size and SHA-256 of the files, by path relative to the folder.
    """

    format: Literal["mirror-rollout"] = "mirror-rollout"
    version: Literal["1.0"] = "1.0"
    scene_id: str
    scenario: str
    scenario_version: int
    policy: str
    policy_hash: str | None = None
    world: World
    model_hash: str | None = None
    dataset_hash: str | None = None
    map_source: MapSource | None = None
    seed: int
    rate_hz: Number
    steps: int = Field(ge=0)
    ending: Ending
    reason: str | None = None
    route_m: tuple[tuple[Number, Number], ...]
    threads: int | None = None
    sensors: str | None = Field(default=None, exclude_if=lambda name: name is None)
    views: dict[str, int] | None = Field(default=None, exclude_if=lambda views: views is None)
    versions: dict[str, str]
    files: dict[str, FileEntry]

    @property
    def hash(self) -> str:
        """SHA-256 of the canonical content without the versions; files are covered by their hashes."""
        # Rollouts that do not state the source of their map keep the hash that they had before.
        unstated = {"map_source"} if self.map_source is None else set()
        plain = self.model_dump(mode="json", exclude={"versions", *unstated})
        return hash_document(plain, HashStyle.CANONICAL)


def read_rollout(folder: Path) -> Rollout:
    """Read the document of a rollout and compare the required files with it.

    Raises:
        DatasetError: the folder holds no complete rollout, or a file is missing or has another hash.
        SchemaError: ``run.json`` is not the document of a rollout.
    """
    path = folder / ROLLOUT
    if not path.is_file():
        raise DatasetError(
            "no complete rollout here",
            file=folder,
            expected=f"a folder with {ROLLOUT}, which `mirror simulate` writes last",
            remedy="run `mirror simulate` to the end, or name its folder",
        )
    rollout = read_json(path, Rollout)
    for name in REQUIRED_FILES:
        entry, file = rollout.files.get(name), folder / name
        if entry is None or not file.is_file() or sha256_bytes(file.read_bytes()) != entry.sha256:
            raise DatasetError(
                "missing, or not the file that was written",
                file=file,
                expected=f"the file with the hash that {ROLLOUT} states",
                remedy="restore the file, or drive the scenario again",
            )
    return rollout


def list_files(folder: Path) -> dict[str, FileEntry]:
    """Return the sizes and hashes of all files of a rollout's folder, apart from ``run.json``, by relative path."""
    entries = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path != folder / ROLLOUT and not path.name.startswith("."):
            data = path.read_bytes()
            entries[path.relative_to(folder).as_posix()] = FileEntry(bytes=len(data), sha256=sha256_bytes(data))
    return entries
