"""`mirror ingest --images video`: the recording's own compressed frames stay, and the dataset reads from them."""

from __future__ import annotations

import hashlib
from pathlib import Path

import av
import numpy as np
import pytest

import mirror
from mirror.arrays import Int64, UInt8
from mirror.dataset.layout import Layout
from mirror.errors import ExitCode
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from mirror.integrity import Cost, check
from mirror.schema.files import read_table
from mirror.schema.tables import IMAGES
from tests.builders.folder import SCENE, START_NS, write_recording

KEEP = IngestOptions(write=WriteOptions(videos="video"))


def film(drive: Path, camera: str, *, b_frames: int = 2, codec: str = "libx264") -> tuple[Int64, dict[int, UInt8]]:
    """Replace a camera's images by a video with irregular stamps; return exposures and decoded frames by exposure."""
    folder = drive / "images" / camera
    stamps = sorted(int(path.stem) for path in folder.iterdir())
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
    (drive / "videos").mkdir(exist_ok=True)
    file = drive / "videos" / f"{camera}.mp4"
    rng = np.random.default_rng(0)
    with av.open(str(file), "w") as container:
        quiet = {"x265-params": "log-level=none"} if codec == "libx265" else {}
        stream = container.add_stream(codec, rate=10, options={"g": "10", "bf": str(b_frames), **quiet})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for number in range(len(stamps)):
            image = np.full((48, 64, 3), 20 + number % 200, np.uint8)
            image[number % 48] = rng.integers(0, 255, (64, 3))
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, "rgb24")))
        container.mux(stream.encode())
    with av.open(str(file)) as container:
        frames = {frame.pts: frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)}
    pts = sorted(frames)
    rows = "".join(f"{p},{t},{t + 2_000_000}\n" for p, t in zip(pts, stamps))
    (drive / "videos" / f"{camera}.csv").write_text("pts,exposure_start_ns,exposure_end_ns\n" + rows)
    return np.array(stamps), {stamp: frames[p] for p, stamp in zip(pts, stamps)}


def test_frames_are_those_of_the_recording_and_nothing_is_encoded(tmp_path: Path) -> None:
    drive = write_recording(tmp_path / "fleet", "there")
    stamps, frames = film(drive, "rear")
    report = ingest_recordings([drive], [SCENE], tmp_path / "d", KEEP)
    assert not report.failures
    recorded = Layout(tmp_path / "d").recorded(report.traversals[0].traversal_id)
    rear = [row for row in read_table(recorded / "images.parquet", IMAGES).to_pylist() if row["camera"] == "rear"]
    inside = [stamp for stamp in stamps if 7.5e9 <= stamp + 1_000_000 - START_NS <= 22.5e9]
    assert [row["exposure_start_ns"] for row in rear] == inside
    assert [row["exposure_end_ns"] - row["exposure_start_ns"] for row in rear] == [2_000_000] * len(inside)
    assert {row["codec"] for row in rear} == {"video"} and len({row["uri"] for row in rear}) == 1
    (file,) = (recorded / "rear").iterdir()
    assert {row["sha256"] for row in rear} == {hashlib.sha256(file.read_bytes()).digest()}
    assert report.bytes == sum(path.stat().st_size for path in recorded.glob("*/*.*"))

    dataset = mirror.open(tmp_path / "d")
    checked = 0
    for frame in reversed(dataset.frames()):
        # At an edge of the pass the reference camera's image may lie inside and this one outside.
        if (image := frame.images.get("rear")) is None:
            continue
        np.testing.assert_array_equal(image.decode(), frames[image.exposure_start_ns])
        checked += 1
    assert checked >= len(inside) - 1
    # Missing, of another length, cut short, of other bytes, undecodable, of another size.
    broken = {f"IMG{number:03}" for number in range(1, 7)}
    assert not [
        finding
        for rule, finding in check(tmp_path / "d", cost=Cost.IMAGES).findings
        if rule.rule_id in broken and "rear" in f"{finding.place} {finding.message}"
    ]
    with file.open("r+b") as writing:
        writing.seek(file.stat().st_size // 2)
        writing.write(b"\0" * 64)
    found = {rule.rule_id for rule, _ in check(tmp_path / "d", cost=Cost.IMAGES).findings}
    assert "IMG004" in found


@pytest.mark.parametrize("codec", ["libx264", "libx265"])
def test_frames_in_any_order(codec: str, tmp_path: Path) -> None:
    """Alone, in pairs, and one after the other: decoders end after a frame, or expect the next one."""
    drive = write_recording(tmp_path / "fleet", "there")
    _, frames = film(drive, "rear", codec=codec)
    ingest_recordings([drive], [SCENE], tmp_path / "d", KEEP)
    images = [frame.images["rear"] for frame in mirror.open(tmp_path / "d").frames() if "rear" in frame.images]
    alone = np.random.default_rng(0).permutation(len(images))
    pairs = [number + step for number in alone[alone < len(images) - 1] for step in (0, 1)]
    for number in [*alone, *pairs, *range(len(images)), *alone]:
        np.testing.assert_array_equal(images[number].decode(), frames[images[number].exposure_start_ns])


def test_the_same_bytes_again_and_without_hashes(tmp_path: Path) -> None:
    drive = write_recording(tmp_path / "fleet", "there")
    film(drive, "rear")
    for name, hashing in (("d", True), ("e", True), ("f", False)):
        options = IngestOptions(write=WriteOptions(videos="video", hashing=hashing, decoding=True))
        report = ingest_recordings([drive], [SCENE], tmp_path / name, options)
        assert not report.failures
    one, two, three = (next((tmp_path / name).glob("traversals/*/recorded/rear/*.mp4")) for name in "def")
    assert one.read_bytes() == two.read_bytes() == three.read_bytes()
    again = ingest_recordings([drive], [SCENE], tmp_path / "d", KEEP)
    assert again.unchanged and not again.images


def test_a_damaged_video_leaves_nothing(tmp_path: Path) -> None:
    drive = write_recording(tmp_path / "fleet", "there")
    film(drive, "rear")
    file = drive / "videos" / "rear.mp4"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 3])
    report = ingest_recordings([drive], [SCENE], tmp_path / "d", KEEP)
    assert len(report.failures) == 1 and "rear.mp4" in str(report.failures[0][1])
    assert not list((tmp_path / "d").glob("traversals/*/recorded"))


def test_the_verb(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from mirror.cli.main import main

    drive = write_recording(tmp_path / "fleet", "there")
    film(drive, "rear")
    code = main(
        ["ingest", str(drive), "--roi", _scene(), "--out", str(tmp_path / "d"), "--images", "video", "--verify-images"]
    )
    assert code == ExitCode.DONE, capsys.readouterr()
    assert list((tmp_path / "d").glob("traversals/*/recorded/rear/*.mp4"))


def _scene() -> str:
    return f"{SCENE.longitude_deg},{SCENE.latitude_deg},{SCENE.radius_m}"
