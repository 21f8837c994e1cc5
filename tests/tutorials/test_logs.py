"""The tutorial of MCAP logs, with the logs of the tiny street: the dataset is that of the recordings themselves."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import mirror
from mirror.recordings.registry import open_recording
from mirror.synth import SynthReport
from tests.tutorial_pages import follow

pytest.importorskip("mcap", reason="needs mcap, of the extra mcap")


def test_logs_become_the_dataset_of_their_recordings(
    tiny_recordings: SynthReport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    def copy_recordings() -> None:
        shutil.copytree(tiny_recordings.recordings[0].parent, "recordings")

    printed = follow("tutorials/logs.md", shorter={}, stand_ins={"synth": copy_recordings}, capsys=capsys)
    (described,) = [text for line, text in printed.items() if line == "mirror info logs/guangzhou-urban-01.mcap"]
    assert "car-01" in described and "uncalibrated" not in described
    dataset = mirror.open("dataset")
    drives = dataset.drives()
    assert len(drives) == 2 and len(dataset.traversals()) == 2
    for drive in drives:
        recording = open_recording(tmp_path / "recordings" / drive)
        streams = recording.images()
        images = {data for stream in streams.values() for _, data in stream.read(range(len(stream.exposure_start_ns)))}
        truth = {row["camera"]: row for row in recording.calibrations().to_pylist() if row["stage"] == "factory"}
        for frame in dataset.where(drive=drive).frames()[::5]:
            for camera, image in frame.images.items():
                assert image.read() in images
                row, lens, pose = truth[camera], image.camera_model, image.calibration.ego_SE3_camera
                assert lens.model == row["model"]
                known = [row[name] for name in ("fx_px", "fy_px", "cx_px", "cy_px", "tx_m", "ty_m", "tz_m", "qw", "qz")]
                found = [
                    lens.fx_px,
                    lens.fy_px,
                    lens.cx_px,
                    lens.cy_px,
                    *pose.translation[0],
                    *pose.rotation[0, [0, 3]],
                ]
                np.testing.assert_allclose(found, known, atol=1e-9)
