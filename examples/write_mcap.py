"""Write recordings as MCAP logs of JSON messages: what a logger of a vehicle writes, for trying and for copying.

python examples/write_mcap.py RECORDING... --out logs

Any recording in WGS 84 that MIRROR reads will do, such as those of `mirror synth`. A log has fixes and orientations of
the ego frame, the mountings of the cameras, their intrinsics and their JPEG images; it needs the package mcap.
"""

from __future__ import annotations

import argparse
import base64
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from mcap.writer import Writer

from mirror.recordings.registry import open_recording

MODELS: Final = {
    "pinhole": "plumb_bob",
    "brown_conrady": "plumb_bob",
    "rational": "rational_polynomial",
    "kannala_brandt": "equidistant",
}
"""The word of a message for each lens; messages have none for f-theta."""
Message = tuple[int, str, str, dict[str, Any]]


def main(arguments: Sequence[str] | None = None) -> None:
    """Write a log for each recording.

    Args:
        arguments: words of the command line; None: those of this process.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path, nargs="+", metavar="RECORDING")
    parser.add_argument("--out", type=Path, required=True, help="folder of the logs")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    for path in given.recordings:
        file = write_log(path, given.out)
        print(f"{file}: {file.stat().st_size / 1e6:.1f} MB")


def write_log(path: Path, out: Path) -> Path:
    """Write a recording as an MCAP log named after its drive.

    Args:
        path: the recording.
        out: the folder of the log.

    Returns:
        The log.
    """
    recording = open_recording(path)
    file = out / f"{recording.info.drive_id}.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="write_mcap.py")
        channels: dict[str, int] = {}
        for stamp, topic, kind, content in sorted(list_messages(recording), key=lambda message: message[0]):
            if topic not in channels:
                schema = writer.register_schema(kind, "jsonschema", b'{"type": "object"}')
                channels[topic] = writer.register_channel(topic, "json", schema)
            writer.add_message(channels[topic], stamp, json.dumps(content).encode(), stamp)
        writer.finish()  # type: ignore[no-untyped-call]
    return file


def list_messages(recording: Any) -> Iterator[Message]:
    """Yield time, topic, type and content of each message of a recording.

    Yields:
        Poses first, then each camera with its images; not in the order of time.
    """
    track = recording.track()
    for row, stamp in enumerate(track.timestamp_ns.tolist()):
        fix = {
            "timestamp": _time(stamp), "frame_id": "base_link", "latitude": float(track.latitude_deg[row]),
            "longitude": float(track.longitude_deg[row]), "altitude": float(track.height_m[row]),
            "position_covariance": [0.0] * 9, "position_covariance_type": 0,
        }  # fmt: skip
        yield stamp, "/gnss/fix", "foxglove.LocationFix", fix
        header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": "base_link"}
        yield stamp, "/imu", "sensor_msgs/msg/Imu", {"header": header, "orientation": _turn(track.rotation[row])}
    calibrations = {row["camera"]: row for row in recording.calibrations().to_pylist() if row["stage"] == "factory"}
    first = int(track.timestamp_ns[0])
    for camera, images in recording.images().items():
        lens, frame = calibrations[camera], f"{camera}_optical"
        mounting = {
            "timestamp": _time(first), "parent_frame_id": "base_link", "child_frame_id": frame,
            "translation": {axis: float(lens[f"t{axis}_m"]) for axis in "xyz"},
            "rotation": _turn([lens[name] for name in ("qw", "qx", "qy", "qz")]),
        }  # fmt: skip
        yield first, "/tf", "foxglove.FrameTransform", mounting
        yield first, f"/{camera}/camera_info", "foxglove.CameraCalibration", _describe_lens(lens, first, frame)
        for number, data in images.read(range(len(images.exposure_start_ns))):
            # The stamp of a message is the middle of the exposure.
            stamp = int(images.exposure_start_ns[number] + images.exposure_end_ns[number]) // 2
            image = {
                "timestamp": _time(stamp), "frame_id": frame, "format": images.codec,
                "data": base64.b64encode(data).decode(),
            }  # fmt: skip
            yield stamp, f"/{camera}/image", "foxglove.CompressedImage", image


def _describe_lens(lens: dict[str, Any], stamp: int, frame: str) -> dict[str, Any]:
    """The intrinsics as a message, in which the centre of the first pixel is at 0 (in MIRROR at 0.5)."""
    K = [lens["fx_px"], 0.0, lens["cx_px"] - 0.5, 0.0, lens["fy_px"], lens["cy_px"] - 0.5, 0.0, 0.0, 1.0]
    return {
        "timestamp": _time(stamp), "frame_id": frame, "width": lens["width_px"], "height": lens["height_px"],
        "distortion_model": MODELS[lens["model"]], "D": list(lens["distortion"]) or [0.0] * 5, "K": K,
    }  # fmt: skip


def _time(stamp: int) -> dict[str, int]:
    return {"sec": stamp // 10**9, "nsec": stamp % 10**9}


def _turn(rotation: Any) -> dict[str, float]:
    return {name: float(value) for name, value in zip("wxyz", rotation)}


if __name__ == "__main__":
    main()
