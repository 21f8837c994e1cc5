"""Measures decoding of a dataset's videos: random and consecutive frames of 1080p, against ffmpeg and PyAV.

``python -m benchmarks videos [--frames N]`` records a drive with one 1920 x 1080 H.264 video (a key frame every 10
frames; two slices a frame, then one), ingests it with ``--images video``, and decodes frames through the dataset. The
error is the number of pixel values that differ from those that PyAV decodes from the recording. Bars: a random frame
in 60 ms, and consecutive frames in at most 1.25 times the time of ``ffmpeg -pix_fmt rgb24`` (where ffmpeg is not
installed: of PyAV). No decoder needs less for a random frame than for the key frame before it, which is therefore
measured beside it.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import mirror
from benchmarks.report import Peer, Row, report
from mirror.arrays import UInt8
from mirror.dataset.image import Image
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from tests.builders.folder import SCENE, write_recording

RANDOM_BAR_MS = 60.0
CONSECUTIVE_BAR = 1.25
_GROUP = 10


def main(argv: list[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=150, help="decoded frames")
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as scratch:
        groups = {
            f"1920 x 1080, H.264, {slices} {name}": _measure(Path(scratch) / str(slices), options.frames, slices)
            for slices, name in ((2, "slices a frame"), (1, "slice a frame"))
        }
        return report("videos", groups)


def _measure(folder: Path, count: int, slices: int) -> Iterator[Row]:
    recording = write_recording(folder / "fleet", "there", cameras=("front_wide",))
    exposures = _film(recording, slices)
    keep = IngestOptions(write=WriteOptions(videos="video"))
    start = time.perf_counter()
    written = ingest_recordings([recording], [SCENE], folder / "d", keep)
    ingested = time.perf_counter() - start
    images = [frame.images["front_wide"] for frame in mirror.open(folder / "d").frames()][:count]
    (video,) = (folder / "d").glob("traversals/*/recorded/*/*.mp4")
    size = f"{len(images)} frames"
    yield Row("ingest, no frame decoded", f"{written.images} frames", ingested * 1e3)
    expected = _decode(recording / "videos" / "front_wide.mp4", exposures, images)
    rng = np.random.default_rng(0)
    chosen = rng.permutation(len(images))[:60]
    times, wrong = [], 0
    for index in chosen.tolist():
        start = time.perf_counter()
        pixels = images[index].decode()
        times.append(time.perf_counter() - start)
        wrong += int(np.count_nonzero(pixels != expected[index]))
    stamps = [pts for index in chosen if (pts := images[index].video_pts) is not None]
    alone = Peer("PyAV, its key frame alone", _decode_key_frames(video, stamps) * 1e3)
    yield Row("a random frame", size, float(np.median(times)) * 1e3, float(wrong), peers=(alone,), bar=RANDOM_BAR_MS)
    ours, theirs = [], []
    for _ in range(3):
        start = time.perf_counter()
        for image in images:
            image.decode()
        ours.append((time.perf_counter() - start) / len(images))
        theirs.append(_peer(video) / written.images)
    peer = "ffmpeg" if shutil.which("ffmpeg") else "PyAV"
    limit = CONSECUTIVE_BAR * float(np.median(theirs)) * 1e3
    yield Row(
        "a consecutive frame",
        size,
        float(np.median(ours)) * 1e3,
        float(wrong),
        peers=(Peer(f"{peer} to RGB", float(np.median(theirs)) * 1e3),),
        bar=limit,
    )


def _film(recording: Path, slices: int) -> dict[int, int]:
    """Replace the camera's images by a video of smooth motion; pts by exposure."""
    import av

    folder = recording / "images" / "front_wide"
    stamps = sorted(int(path.stem) for path in folder.iterdir())
    shutil.rmtree(folder)
    (recording / "videos").mkdir()
    calibration = recording / "calibrations" / "factory.json"
    lenses = json.loads(calibration.read_text())
    for lens in lenses:
        lens |= {"width_px": 1920, "height_px": 1080, "fx_px": 1500.0, "fy_px": 1500.0, "cx_px": 960.0, "cy_px": 540.0}
    calibration.write_text(json.dumps(lenses))
    small = np.random.default_rng(0).integers(0, 255, (1080 // 8 + 40, 1920 // 8 + 80, 3), np.uint8)
    large = np.repeat(np.repeat(small, 8, axis=0), 8, axis=1)
    with av.open(str(recording / "videos" / "front_wide.mp4"), "w") as container:
        coding = {
            "g": str(_GROUP),
            "crf": "20",
            "preset": "veryfast",
            "x264-params": f"sliced-threads=0:slices={slices}",
        }
        stream = container.add_stream("libx264", rate=10, options=coding)
        stream.width, stream.height, stream.pix_fmt = 1920, 1080, "yuv420p"
        for number in range(len(stamps)):
            view = large[number % 300 : number % 300 + 1080, (2 * number) % 600 : (2 * number) % 600 + 1920]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(view), "rgb24")))
        container.mux(stream.encode())
    with av.open(str(recording / "videos" / "front_wide.mp4")) as container:
        pts = sorted(packet.pts for packet in container.demux(video=0) if packet.pts is not None)
    rows = "".join(f"{p},{t},{t}\n" for p, t in zip(pts, stamps))
    (recording / "videos" / "front_wide.csv").write_text("pts,exposure_start_ns,exposure_end_ns\n" + rows)
    return dict(zip(stamps, pts))


def _decode(file: Path, exposures: dict[int, int], images: list[Image]) -> list[UInt8]:
    """The reference: PyAV decodes the recording from the start."""
    import av

    wanted = {exposures[image.exposure_start_ns]: index for index, image in enumerate(images)}
    found: dict[int, UInt8] = {}
    with av.open(str(file)) as container:
        for frame in container.decode(video=0):
            if frame.pts in wanted:
                found[wanted[frame.pts]] = np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)
    return [found[index] for index in range(len(images))]


def _decode_key_frames(video: Path, stamps: list[int]) -> float:
    """Median seconds to decode the key frame of a frame, and nothing else."""
    import av

    times = []
    with av.open(str(video)) as container:
        keys = {p.pts: p for p in container.demux(video=0) if p.size and p.is_keyframe and p.pts is not None}
        context = container.streams.video[0].codec_context
        for stamp in stamps:
            start = time.perf_counter()
            context.decode(keys[max(pts for pts in keys if pts <= stamp)])
            context.decode(None)
            times.append(time.perf_counter() - start)
            context.flush_buffers()
    return float(np.median(times))


def _peer(video: Path) -> float:
    """Seconds to decode a whole video to RGB: ffmpeg where it is installed, else PyAV."""
    start = time.perf_counter()
    if shutil.which("ffmpeg"):
        command = ["ffmpeg", "-v", "error", "-i", str(video), "-pix_fmt", "rgb24", "-f", "rawvideo", "-y", "/dev/null"]
        subprocess.run(command, check=True)
    else:
        import av

        with av.open(str(video)) as container:
            container.streams.video[0].thread_type = "AUTO"
            for frame in container.decode(video=0):
                frame.to_ndarray(format="rgb24")
    return time.perf_counter() - start
