"""The topics file: a small TOML that says which topics of a log are the drive, and a proposal of it for any log."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, ValidationError, model_validator

from mirror.errors import RecordingError
from mirror.recordings.mounting import mounting_pose
from mirror.recordings.opening import read_file
from mirror.recordings.paths import to_identifier
from mirror.recordings.protocol import choose_reference_camera
from mirror.recordings.readers.message_logs.container import Topic
from mirror.recordings.readers.message_logs.decoding import RAW_IMAGES, kind_of
from mirror.schema.documents import Document, Identifier
from mirror.schema.problems import describe_problems
from mirror.schema.strict_toml import TomlError, decode_toml

CANONICAL: Final = ("front_wide", "front_narrow", "front_left", "front_right", "rear_left", "rear_right", "rear")
_STRICT: Final = "a topics file as docs/recordings/mcap.md describes it"


class PoseTopics(Document):
    """The source of the poses: a topic, or a chain of transforms.

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
    """The topics of one camera.

    Attributes:
        images: compressed images, or packets of a compressed video.
        info: intrinsics; None: those of `lens`, and without both the camera is uncalibrated.
        lens: YAML file of the lens beside the topics file, in place of a topic of intrinsics; ``FILE:cam1`` names a
            camera of a file of Kalibr.
        mounting: the camera in the ego frame (`mirror.recordings.mounting.mounting_pose`), in place of transforms.
        frame: the camera's optical frame; None: that of the images.
        static_mask: PNG beside the topics file, non-zero where the image shows the vehicle itself.
    """

    images: str
    info: str | None = None
    lens: str | None = None
    mounting: tuple[float, ...] | None = None
    frame: str | None = None
    static_mask: str | None = None

    @model_validator(mode="after")
    def _one_lens(self) -> CameraTopics:
        if self.info is not None and self.lens is not None:
            raise ValueError("info and lens are two sources of one lens: leave one of them out")
        if self.lens is not None and self.mounting is None:
            raise ValueError("lens needs mounting = [x, y, z, roll, pitch, yaw]")
        if self.mounting is not None:
            mounting_pose(self.mounting)
        return self


class TopicsFile(Document):
    """The topics file of a log, which says which topics hold images and poses.

    Attributes:
        drive_id: None: from the name of the log.
        vehicle_id: pseudonym of the vehicle.
        vehicle_type: make or class of the vehicle.
        rig_id: name of the rig; None: that of the vehicle.
        reference_camera: the camera that defines the frames; None: ``front_wide`` if there is one, else the first.
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
        RecordingError: it is missing, not TOML, or keys are not as specified; all of them are named.
    """
    try:
        return TopicsFile.model_validate(decode_toml(read_file(file)))
    except TomlError as error:
        raise RecordingError(f"is not TOML ({error})", file=file, expected=_STRICT, remedy="correct it") from error
    except ValidationError as error:
        problem, place = describe_problems(error.errors())
        raise RecordingError(
            problem,
            file=file,
            place=place,
            expected=_STRICT,
            remedy="correct what is named, or begin with the proposal of `mirror info LOG`",
        ) from error


def require_topics(document: TopicsFile, topics: Mapping[str, Topic], file: Path) -> None:
    """Refuse a topics file with topics that the log lacks or that are of another kind.

    Raises:
        RecordingError: all such keys and topics are named.
    """
    named: list[tuple[str, str | None, tuple[str, ...]]] = [
        ("pose.topic", document.pose.topic, ("fix", "pose")),
        ("pose.orientation", document.pose.orientation, ("orientation", "pose")),
    ]
    for name, camera in document.cameras.items():
        named += [(f"cameras.{name}.images", camera.images, ("image", "video"))]
        named += [(f"cameras.{name}.info", camera.info, ("camera",))]
    faults: dict[str, tuple[str, str, str]] = {}
    for key, topic, kinds in named:
        if topic is None:
            continue
        if topic not in topics:
            listed = f"one of {', '.join(sorted(topics)) or 'no topics: the log is empty'}"
            faults[key] = f"the log has no topic {topic!r}", listed, "correct the key"
        elif kind_of(topics[topic]) not in kinds:
            raw = topics[topic].type.replace("/msg/", "/") in RAW_IMAGES
            faults[key] = (
                f"topic {topic} has the type {topics[topic].type}",
                f"messages of the kind {' or '.join(kinds)}",
                "compress the images (image_transport), raw ones are not read" if raw else "name another topic",
            )
    if not faults:
        return
    expected, remedies = ("; ".join(dict.fromkeys(fault[part] for fault in faults.values())) for part in (1, 2))
    problems = [fault[0] if len(faults) == 1 else f"{key}: {fault[0]}" for key, fault in faults.items()]
    problem = problems[0] if len(faults) == 1 else f"{len(faults)} faults: {'; '.join(problems)}"
    raise RecordingError(problem, file=file, place=", ".join(faults), expected=expected, remedy=remedies)


def propose_topics(topics: Mapping[str, Topic], name: str) -> str:
    """Propose a topics file for a log, as text.

    Decisions that names and types allow are filled in, choices are comments.

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
        'vehicle_type = "unknown"     # make or class of the vehicle',
        '# rig_id = "rig_unknown"     # the same for all vehicles with these cameras at these mountings',
        'stamps = "header"            # "log": the time of logging, where the sensors have no common clock',
        'ego_frame = "base_link"      # the frame at the rear axle on the ground',
    ]
    sources = by_kind.get("image", []) + by_kind.get("video", [])
    cameras = _name_cameras(sources)
    if cameras:
        reference = f'reference_camera = "{choose_reference_camera(list(cameras))}"'
        lines.append(f"{reference}   # its exposures define the frames")
    lines += [
        '# licence = "CC-BY-NC-4.0"   # of the data; city = "Berlin", weather = "clear" if you know them',
        "",
        "[pose]",
    ]
    lines += _pose_lines(by_kind)
    for camera, images in cameras.items():
        lines += ["", f"[cameras.{camera}]", f'images = "{images}"']
        info = _nearest(images, by_kind.get("camera", []))
        lines += (
            [f'info = "{info}"']
            if info
            else ['# lens = "lens.yaml"   # no topic of intrinsics was found; `mirror calibrate intrinsics` makes it']
        )
        lines.append(
            "# mounting = [1.5, 0, 1.4, 0, 0, 0]   # x y z (m), roll pitch yaw (degrees), if no transform has it"
        )
        lines.append(f'# static_mask = "{camera}.png"   # white where the images show the vehicle itself')
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
