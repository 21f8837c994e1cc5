"""The topics file: a small TOML that says which topics of a log are the drive, and a proposal of it for any log."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, ValidationError, model_validator

from mirror.errors import RecordingError
from mirror.recordings.opening import read_file
from mirror.recordings.paths import to_identifier
from mirror.recordings.readers.message_logs.container import Topic
from mirror.recordings.readers.message_logs.decoding import RAW_IMAGES, kind_of
from mirror.schema.documents import Document, Identifier
from mirror.schema.problems import describe_problem
from mirror.schema.strict_toml import TomlError, decode_toml

CANONICAL: Final = ("front_wide", "front_narrow", "front_left", "front_right", "rear_left", "rear_right", "rear")
_STRICT: Final = "a topics file as docs/recordings.md describes it"


class PoseTopics(Document):
    """Where the poses come from: a topic, or a chain of transforms.

    Attributes:
        topic: satellite fixes (WGS 84), or poses in a local metric frame.
        orientation: for fixes, a topic of orientations in east-north-up (Imu, Odometry, PoseStamped); None: none.
        transform: in place of a topic, the fixed frame and the vehicle's frame of the transforms.
        frame: name of the local metric frame in the dataset; None: the messages' own.
    """

    topic: str | None = None
    orientation: str | None = None
    transform: tuple[str, str] | None = None
    frame: Identifier | None = None

    @model_validator(mode="after")
    def _one_source(self) -> PoseTopics:
        if (self.topic is None) == (self.transform is None):
            raise ValueError("exactly one of topic and transform is needed")
        return self


class CameraTopics(Document):
    """Topics of one camera.

    Attributes:
        images: compressed images, or packets of a compressed video.
        info: intrinsics; None: the camera is uncalibrated.
        frame: the camera's optical frame; None: that of the images.
    """

    images: str
    info: str | None = None
    frame: str | None = None


class TopicsFile(Document):
    """The document.

    Attributes:
        drive_id: None: from the name of the log.
        vehicle_id: pseudonym of the vehicle.
        vehicle_type: make or class of the vehicle.
        rig_id: name of the rig; None: that of the vehicle.
        reference_camera: the camera that defines the frames; None: the first one.
        stamps: ``header``: the messages' own stamps; ``log``: when they were logged.
        ego_frame: the frame at the rear axle on the ground, x forward, y left, z up.
        pose: where the poses come from.
        cameras: topics by the camera's name.
        weather: ``clear``, ``clouds``, ``rain``, ``snow`` or ``fog``; None: not stated.
        light: ``day``, ``dusk`` or ``night``; None: it is computed from the sun.
        city: the city.
        licence: licence of the recording.
    """

    drive_id: Identifier | None = None
    vehicle_id: Identifier = "unknown"
    vehicle_type: str = "unknown"
    rig_id: Identifier | None = None
    reference_camera: str | None = None
    stamps: Literal["header", "log"] = "header"
    ego_frame: str = "base_link"
    pose: PoseTopics
    cameras: Annotated[dict[Identifier, CameraTopics], Field(default_factory=dict)]
    weather: Literal["clear", "clouds", "rain", "snow", "fog"] | None = None
    light: Literal["day", "dusk", "night"] | None = None
    city: str | None = None
    licence: str | None = None

    @model_validator(mode="after")
    def _reference(self) -> TopicsFile:
        if self.reference_camera is not None and self.reference_camera not in self.cameras:
            raise ValueError("reference_camera is none of the cameras")
        return self


def read_topics_file(file: Path) -> TopicsFile:
    """Read a topics file.

    Raises:
        RecordingError: it is missing, not TOML, or a key is not as specified; the key is named.
    """
    try:
        return TopicsFile.model_validate(decode_toml(read_file(file)))
    except TomlError as error:
        raise RecordingError(f"is not TOML ({error})", file=file, expected=_STRICT, remedy="correct it") from error
    except ValidationError as error:
        first = error.errors()[0]
        raise RecordingError(
            f"{describe_problem(first)} (got {first.get('input')!r:.80})",
            file=file,
            place=".".join(str(part) for part in first["loc"]) or "the whole document",
            expected=_STRICT,
            remedy="correct the key, or begin with the proposal of `mirror info LOG`",
        ) from error


def require_topics(document: TopicsFile, topics: Mapping[str, Topic], file: Path) -> None:
    """Refuse a topics file that names topics which the log lacks, or which are of another kind.

    Raises:
        RecordingError: the key and the topic are named.
    """
    named: list[tuple[str, str | None, tuple[str, ...]]] = [
        ("pose.topic", document.pose.topic, ("fix", "pose")),
        ("pose.orientation", document.pose.orientation, ("orientation", "pose")),
    ]
    for name, camera in document.cameras.items():
        named += [(f"cameras.{name}.images", camera.images, ("image", "video"))]
        named += [(f"cameras.{name}.info", camera.info, ("camera",))]
    for key, topic, kinds in named:
        if topic is None:
            continue
        if topic not in topics:
            raise RecordingError(
                f"the log has no topic {topic!r}",
                file=file,
                place=key,
                expected=f"one of {', '.join(sorted(topics)) or 'no topics: the log is empty'}",
                remedy="correct the key",
            )
        if kind_of(topics[topic]) not in kinds:
            raw = topics[topic].type.replace("/msg/", "/") in RAW_IMAGES
            raise RecordingError(
                f"topic {topic} has the type {topics[topic].type}",
                file=file,
                place=key,
                expected=f"messages of the kind {' or '.join(kinds)}",
                remedy="compress the images (image_transport), raw ones are not read" if raw else "name another topic",
            )


def propose_topics(topics: Mapping[str, Topic], name: str) -> str:
    """A topics file for a log, as text: what can be decided from names and types is filled in, choices are comments.

    Args:
        topics: the log's topics.
        name: the log's name, for the drive's id.
    """
    by_kind: dict[str, list[str]] = {}
    for topic in sorted(topics):
        kind = kind_of(topics[topic])
        if kind is not None:
            by_kind.setdefault(kind, []).append(topic)
    lines = [
        f'drive_id = "{to_identifier(name)}"',
        'vehicle_id = "unknown"       # a pseudonym',
        'vehicle_type = "unknown"',
        'stamps = "header"            # "log": the time of logging, where the sensors have no common clock',
        'ego_frame = "base_link"      # the frame at the rear axle on the ground',
        "",
        "[pose]",
    ]
    lines += _pose_lines(by_kind)
    sources = by_kind.get("image", []) + by_kind.get("video", [])
    for camera, images in _name_cameras(sources).items():
        lines += ["", f"[cameras.{camera}]", f'images = "{images}"']
        info = _nearest(images, by_kind.get("camera", []))
        lines.append(f'info = "{info}"' if info else '# info = "..."        # no topic of intrinsics was found')
    if not sources:
        lines += ["", "# The log has no topic of compressed images or video: the drive has poses only."]
    raw = [topic for topic in sorted(topics) if topics[topic].type.replace("/msg/", "/") in RAW_IMAGES]
    lines += [f"# Not read, because it is not compressed: {topic}" for topic in raw]
    return "\n".join(lines) + "\n"


def _pose_lines(by_kind: Mapping[str, list[str]]) -> list[str]:
    fixes, poses, turns = (by_kind.get(kind, []) for kind in ("fix", "pose", "orientation"))
    lines = [f'topic = "{topic}"' for topic in (*fixes, *poses)]
    if not lines:
        if by_kind.get("transforms"):
            return ['transform = ["map", "base_link"]   # the fixed frame, and the vehicle\'s']
        return ["# The log has no topic of poses, fixes or transforms: it cannot be ingested."]
    lines = [lines[0], *(f"# {line}" for line in lines[1:])]
    if fixes:
        lines += [
            line if number == 0 else f"# {line}"
            for number, line in enumerate(f'orientation = "{topic}"   # in east-north-up' for topic in (*turns, *poses))
        ]
    return lines


def _name_cameras(topics: list[str]) -> dict[str, str]:
    """Names for cameras: the canonical name that a topic contains, else the part in which the topics differ."""
    named: dict[str, str] = {}
    for topic in topics:
        words = re.sub(r"[^a-z0-9]+", "_", topic.lower()).strip("_")
        canonical = [name for name in CANONICAL if re.search(rf"(^|_){name}(_|$)", words)]
        parts = [part for part in topic.split("/") if part]
        others = [set(other.split("/")) for other in topics if other != topic]
        own = [part for part in parts if not any(part in other for other in others)] if others else parts[:1]
        name = max(canonical, key=len) if canonical else to_identifier("_".join(own) or words)
        while name in named:
            name += "_2"
        named[name] = topic
    return named


def _nearest(topic: str, candidates: list[str]) -> str | None:
    """The topic of intrinsics whose namespace holds a camera's topic: the innermost one."""
    holding = [other for other in candidates if topic.startswith(other.rpartition("/")[0] + "/")]
    return max(holding, key=lambda other: other.count("/"), default=None)
