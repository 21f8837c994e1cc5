"""Descriptions of frames: a caption, the light and the weather, from what is recorded or from a plug-in.

A package offers a describer by an entry point of the group ``mirror.describers``, in the shape of an annotator.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Final, Protocol, get_args

from mirror.annotation.detections import AnnotationError
from mirror.annotation.frame_program import FrameProgram, program_settings
from mirror.annotation.protocol import require_settings
from mirror.dataset.content_hashes import ContentHashes
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.errors import DatasetError, MirrorError, UsageError
from mirror.plugins import PluginKind
from mirror.progress import NullProgress, ProgressReporter
from mirror.recordings.light import Light
from mirror.recordings.weather import WEATHER
from mirror.schema.finished_work import hash_values
from mirror.schema.hashing import hash_document
from mirror.schema.json_lines import append_line, decode_object, read_lines

DESCRIBERS: Final = PluginKind("describer", "mirror.describers", "--describer", "models")
FORMAT: Final = "mirror-descriptions/1"
REQUEST: Final = "mirror-describe/1"
_LIGHTS: Final[tuple[str, ...]] = get_args(Light)
_LEAST_SCORE: Final = 0.3


@dataclass(frozen=True)
class Description:
    """The description of a frame, from the sun's position, the recording and its boxes.

    Attributes:
        text: a caption; it may be empty.
        light: ``day``, ``dusk`` or ``night``; None: not known.
        weather: ``clear``, ``clouds``, ``rain``, ``snow`` or ``fog``; None: not known.

    Raises:
        AnnotationError: a word is not one of these.
    """

    text: str
    light: str | None = None
    weather: str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.text, str):
            raise AnnotationError(f"text {self.text!r}", expected="a text")
        for name, word, known in (("light", self.light, _LIGHTS), ("weather", self.weather, WEATHER)):
            if word is not None and word not in known:
                raise AnnotationError(f"{name} {word!r}", expected=f"one of {', '.join(known)}, or none")


class Describer(Protocol):
    """A plug-in that describes frames.

    Attributes:
        fingerprint: identifies all that its results depend on apart from the frames.
    """

    fingerprint: str

    def describe(self, frame: Frame) -> Description:
        """Describe one frame.

        Raises:
            MirrorError: there is no valid result for this frame; the run notes it and goes on.
        """

    def close(self) -> None:
        """Release the describer's processes and devices."""


class InstalledDescriber(Protocol):
    """The object that an entry point ``mirror.describers`` names."""

    settings: Mapping[str, str]

    def open(self, dataset: Dataset, settings: Mapping[str, str], device: str) -> Describer:
        """Open the describer; see `mirror.annotation.protocol.InstalledAnnotator.open`."""


class RecordedDescriber:
    """A describer that states light, weather, the kind of scene and the chosen boxes from the recording.

    Args:
        dataset: the dataset, or the view, to be described.
    """

    fingerprint = "recorded"
    reads_images = False

    def __init__(self, dataset: Dataset) -> None:
        scenes = {row["scene_id"]: row for row in dataset.table("scenes").to_pylist()}
        columns = ["traversal_id", "scene_id", "light", "weather", "layers"]
        rows = dataset.table("traversals", columns).to_pylist()
        self._traversals = {row["traversal_id"]: row for row in rows}
        self._scenes = scenes

    def describe(self, frame: Frame) -> Description:
        """Describe one frame."""
        row = self._traversals[frame.traversal_id]
        scene = self._scenes[row["scene_id"]]
        weather = row["weather"] if row["weather"] in WEATHER else None
        place = f"{scene.get('scene_type') or ''} street".strip()
        city = f" in {scene['city']}" if scene.get("city") else ""
        parts = [f"A{'n' if place[0] in 'aeiou' else ''} {place}{city}", f"{row['light']}"]
        if weather is not None:
            parts.append(weather)
        if sum(name.startswith("boxes/") for name in row["layers"]) == 1:
            parts.append(_count_boxes(frame))
        return Description(", ".join(filter(None, parts)), row["light"], weather)

    def close(self) -> None:
        """Do nothing: nothing is held."""


def _count_boxes(frame: Frame) -> str:
    boxes = frame.boxes()
    named = Counter(name for name, score in zip(boxes.category, boxes.score) if not score < _LEAST_SCORE)
    return ", ".join(f"{count} {name}" for name, count in sorted(named.items()))


class ProgramDescriber:
    """A describer that asks a program in another environment.

    Args:
        command: words of the command.
        limit_s: seconds that one answer may take.
    """

    def __init__(self, command: list[str], limit_s: float) -> None:
        self.fingerprint = f"subprocess {hash_document(command)}"
        self._program = FrameProgram(command, limit_s, REQUEST)

    def describe(self, frame: Frame) -> Description:
        """Ask the program; a program that fails is restarted and asked once more."""
        answer = self._program.ask(frame)
        if "text" not in answer:
            raise AnnotationError("no `text`", place="subprocess", expected="a text, which may be empty")
        return Description(answer["text"], answer.get("light"), answer.get("weather"))

    def close(self) -> None:
        """End the program."""
        self._program.close()


class _Recorded:
    takes_device = False
    settings: Mapping[str, str] = {}

    def open(self, dataset: Dataset, settings: Mapping[str, str], device: str) -> Describer:
        """There are no settings."""
        require_settings("recorded", settings, self.settings)
        return RecordedDescriber(dataset)


class _Subprocess:
    takes_device = False
    settings: Mapping[str, str] = {
        "command": "the program and its arguments, as a shell would split them",
        "limit_s": "seconds that a frame may take, 60 by default",
    }

    def open(self, dataset: Dataset, settings: Mapping[str, str], device: str) -> Describer:
        """Check the settings."""
        require_settings("subprocess", settings, self.settings)
        return ProgramDescriber(*program_settings(settings))


RECORDED: Final = _Recorded()
SUBPROCESS: Final = _Subprocess()


def installed_describer(name: str) -> InstalledDescriber:
    """Load an installed describer by its entry-point name.

    Raises:
        UsageError: no describer of that name is installed, or one of its dependencies is missing.
    """
    describer = DESCRIBERS.load(name)
    DESCRIBERS.require_parts(describer, name, InstalledDescriber)
    loaded: InstalledDescriber = describer
    return loaded


@dataclass
class DescriptionReport:
    """The counts of a run that described frames.

    Attributes:
        path: the file.
        frames: frames described in this run.
        kept: frames that the file had already.
        failed: traversal, frame and reason of the frames without a description.
    """

    path: str
    frames: int = 0
    kept: int = 0
    failed: list[tuple[str, int, str]] = field(default_factory=list)


def describe_frames(
    dataset: Dataset, describer: Describer, out: Path, progress: ProgressReporter | None = None
) -> DescriptionReport:
    """Describe all frames of a view, one line of JSON each; the same call continues after an interruption.

    Args:
        dataset: a dataset or a view.
        describer: describes the frames.
        out: the file; the first line names its format and the describer. A frame whose images, boxes or light have
            changed since it was described gets a further line, which counts.
        progress: receives the number of frames.

    Raises:
        UsageError: the file is another one, or was made by another describer.
        DatasetError: the file cannot be written, or is broken.
    """
    progress = progress or NullProgress()
    header = {"format": FORMAT, "describer": describer.fingerprint}
    known: dict[tuple[str, int], str | None] = {}
    if out.exists():
        found = read_lines(out, decode_object)
        if not found or found[0] != header:
            raise UsageError(
                "not a file of descriptions by this describer", file=out, expected=f"{FORMAT}, {describer.fingerprint}",
                remedy="name another file with --out",
            )  # fmt: skip
        known = {(row["traversal_id"], row["timestamp_ns"]): row.get("inputs") for row in found[1:]}
    else:
        append_line(out, json.dumps(header))
    report = DescriptionReport(str(out))
    hashes = ContentHashes(dataset.store)
    progress.start("frames", len(dataset.frames()))
    for traversal_id in dataset.traversals():
        view = dataset.where(traversal=traversal_id)
        conditions = _hash_conditions(view, hashes)
        for frame in view.frames():
            inputs = hashes.frame(frame, conditions, images=getattr(describer, "reads_images", True))
            if known.get((traversal_id, frame.timestamp_ns)) == inputs:
                report.kept += 1
            elif (description := _describe(frame, describer, report, progress)) is not None:
                row = {"traversal_id": traversal_id, "frame_index": frame.frame_index}
                row |= {"timestamp_ns": frame.timestamp_ns, **asdict(description), "inputs": inputs}
                append_line(out, json.dumps(row))
                report.frames += 1
            progress.advance(1)
    return report


def _hash_conditions(view: Dataset, hashes: ContentHashes) -> str:
    """Hash what a description of the frames of one traversal depends on beside the images."""
    row, scene = view.table("traversals").to_pylist()[0], view.table("scenes").to_pylist()[0]
    boxes = {name: hashes.traversal(row["traversal_id"], [name]) for name in row["layers"] if name.startswith("boxes/")}
    words = [row["light"], row["weather"], scene.get("scene_type"), scene.get("city")]
    return hash_values(hashes.view(view), boxes, words)


def _describe(
    frame: Frame, describer: Describer, report: DescriptionReport, progress: ProgressReporter
) -> Description | None:
    try:
        return describer.describe(frame)
    except MirrorError as error:
        report.failed.append((frame.traversal_id, frame.frame_index, str(error)))
        progress.message(f"frame {frame.frame_index} of {frame.traversal_id}: {error}")
        return None


def read_descriptions(path: Path) -> dict[tuple[str, int], Description]:
    """Return the descriptions by traversal and number of the frame.

    Raises:
        DatasetError: the file is missing, broken or of another format.
    """
    if not path.is_file():
        raise DatasetError("no such file", file=path, expected="a file of `mirror annotate describe`")
    rows = read_lines(path, decode_object)
    if not rows or rows[0].get("format") != FORMAT:
        raise DatasetError("not a file of descriptions", file=path, expected=FORMAT)
    return {
        (row["traversal_id"], row["frame_index"]): Description(row["text"], row["light"], row["weather"])
        for row in rows[1:]
    }
