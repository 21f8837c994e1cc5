"""One pass over the logs of a drive: everything but image bytes, which stay where they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mirror.errors import RecordingError
from mirror.recordings.readers.message_logs.container import Message, MessageLog, MessagePlace, Topic
from mirror.recordings.readers.message_logs.decoding import (
    CameraMessage,
    Decoded,
    FixMessage,
    ImageMessage,
    MessageDecoder,
    PoseMessage,
    TransformsMessage,
    kind_of,
)
from mirror.recordings.readers.message_logs.images import VIDEO_SUFFIXES, image_codec, is_key_packet
from mirror.recordings.readers.message_logs.topics_file import TopicsFile
from mirror.recordings.readers.message_logs.transforms import Transforms


@dataclass
class CameraContents:
    """The images of one camera in storage order.

    ``format`` is ``jpeg``, ``png``, or the suffix of a raw video. ``declared_uncalibrated``: messages of its intrinsics
    state that the camera is not calibrated; they are not among ``intrinsics``.
    """

    topic: Topic
    format: str = ""
    frame: str = ""
    stamps: list[int] = field(default_factory=list)
    log: list[int] = field(default_factory=list)
    places: list[MessagePlace] = field(default_factory=list)
    is_key: list[bool] = field(default_factory=list)
    intrinsics: list[tuple[int, CameraMessage]] = field(default_factory=list)
    declared_uncalibrated: bool = False


@dataclass
class Contents:
    """The transforms, poses and images that one pass over a log found.

    Attributes:
        poses: fixes or poses with their stamps, in storage order.
        turns: orientations with their stamps.
        cameras: by name.
        transforms: between frames.
        damage: what could not be read, each with its error.
    """

    transforms: Transforms
    poses: list[tuple[int, FixMessage | PoseMessage]] = field(default_factory=list)
    turns: list[tuple[int, PoseMessage]] = field(default_factory=list)
    cameras: dict[str, CameraContents] = field(default_factory=dict)
    damage: list[RecordingError] = field(default_factory=list)


def read_contents(logs: Sequence[MessageLog], document: TopicsFile) -> Contents:
    """Read the topics of a topics file from all files of a drive.

    Damaged blocks and messages are left out and listed.

    Raises:
        RecordingError: a file is no log, or images have a format that is not read.
    """
    contents = Contents(Transforms(logs[0].path))
    for number, log in enumerate(logs):
        _read_log(number, log, document, contents)
    return contents


def _read_log(number: int, log: MessageLog, document: TopicsFile, contents: Contents) -> None:
    topics = log.topics()
    roles: dict[str, list[tuple[str, str]]] = {}
    for name, topic in topics.items():
        if kind_of(topic) == "transforms":
            roles.setdefault(name, []).append(("transforms", ""))
    for role, topic_name in (("pose", document.pose.topic), ("turn", document.pose.orientation)):
        if topic_name in topics:
            roles.setdefault(topic_name, []).append((role, ""))
    for camera, entry in document.cameras.items():
        if entry.images in topics:
            contents.cameras.setdefault(camera, CameraContents(topics[entry.images]))
            roles.setdefault(entry.images, []).append(("image", camera))
        if entry.info in topics:
            roles.setdefault(entry.info, []).append(("info", camera))
    decoder = MessageDecoder(log.path)
    for message in log.messages(roles):
        try:
            decoded = decoder.decode(message)
        except RecordingError as error:
            contents.damage.append(error)
            continue
        for role, camera in roles[message.topic.name]:
            _take(role, camera, number, message, decoded, log, document, contents)
    contents.damage += log.damage()


def _take(
    role: str,
    camera: str,
    number: int,
    message: Message,
    decoded: Decoded,
    log: MessageLog,
    document: TopicsFile,
    contents: Contents,
) -> None:
    if isinstance(decoded, TransformsMessage):
        for one in decoded.transforms:
            contents.transforms.add(one.header.frame, one.child, one.header.stamp_ns, one.pose)
        return
    stamp = message.log_time_ns if document.stamps == "log" else decoded.header.stamp_ns
    if isinstance(decoded, FixMessage | PoseMessage):
        if role == "pose":
            contents.poses.append((stamp, decoded))
        elif isinstance(decoded, PoseMessage):
            contents.turns.append((stamp, decoded))
    elif isinstance(decoded, CameraMessage):
        _take_intrinsics(contents.cameras.get(camera), decoded, stamp)
    else:
        _take_image(contents.cameras[camera], camera, number, message, decoded, stamp, log)


def _take_intrinsics(entry: CameraContents | None, decoded: CameraMessage, stamp: int) -> None:
    if entry is None:
        return
    if not decoded.is_calibrated:
        entry.declared_uncalibrated = True
    # An intrinsics message per image: only changes are kept.
    elif not (entry.intrinsics and _same_lens(entry.intrinsics[-1][1], decoded)):
        entry.intrinsics.append((stamp, decoded))


def _take_image(
    entry: CameraContents,
    camera: str,
    number: int,
    message: Message,
    decoded: ImageMessage,
    stamp: int,
    log: MessageLog,
) -> None:
    video = VIDEO_SUFFIXES.get(decoded.format.lower()) if kind_of(message.topic) == "video" else None
    found = video or image_codec(decoded.data)
    if found is None or (entry.format and found != entry.format):
        raise RecordingError(
            f"an image has the format {decoded.format!r}" + (f" after {entry.format}" if found else ""),
            file=log.path,
            place=f"camera {camera}, topic {message.topic.name}, stamp {stamp}",
            expected="JPEG or PNG images, or H.264 or H.265 packets, of one format for each camera",
            remedy="convert the topic, or leave the camera out of the topics file",
        )
    entry.format, entry.frame = found, decoded.header.frame
    entry.stamps.append(stamp)
    entry.log.append(number)
    entry.places.append(message.place)
    entry.is_key.append(video is not None and is_key_packet(decoded.data, video))


def _same_lens(one: CameraMessage, other: CameraMessage) -> bool:
    def facts(message: CameraMessage) -> tuple[object, ...]:
        return message.width_px, message.height_px, message.model, message.distortion

    return facts(one) == facts(other) and np.array_equal(one.K, other.K)
