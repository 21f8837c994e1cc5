"""The tutorial from a phone video to a drive through it, with a short drive through a corridor."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import cv2
import pytest

from mirror.recordings.lens_files import write_lens
from tests.calibration.corridor import LENS
from tests.tutorial_pages import follow

pytest.importorskip("pycolmap")
pytest.importorskip("torch")
av = pytest.importorskip("av")


def test_a_video_becomes_a_drive(
    images: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with av.open("drive.mp4", "w") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.options = {"crf": "8"}
        for number, file in enumerate(sorted(images.iterdir())):
            frame = av.VideoFrame.from_ndarray(cv2.imread(str(file)), format="bgr24")
            if not number:
                stream.width, stream.height, stream.pix_fmt = frame.width, frame.height, "yuv420p"
            frame.pts, frame.time_base = number, Fraction(1, 10)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    write_lens(tmp_path / "lens.yaml", LENS)
    follow(
        "phone-video.md",
        shorter={
            "poses": {"": ["--lens", "lens.yaml", "--neighbours", "4"]},
            "reconstruct": {"--minutes": ["--steps"], "10": ["2", "--width", "48", "--threads", "1"]},
            "render": {"": ["--width", "48", "--hz", "2"]},
        },
        stand_ins={"view": lambda: None},
        capsys=capsys,
    )
    with av.open("beside.mp4") as video:
        assert sum(1 for _ in video.decode(video=0)) >= 2
