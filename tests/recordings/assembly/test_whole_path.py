"""From an mp4, poses in CSV and images of a chessboard to a rendered reconstruction, by the commands alone."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.cli.main import main
from tests.recordings.assembly.street import (
    LATITUDE,
    LENS,
    LONGITUDE,
    START_NS,
    write_boards,
    write_film,
    write_track,
)


def run(*words: object) -> None:
    """Run a command that must end with 0."""
    assert main([str(word) for word in words]) == 0, words


def test_from_a_film_and_a_track_to_a_render(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    boards = write_boards(tmp_path / "boards")
    lens = tmp_path / "lens.yaml"
    assert main(["calibrate", "intrinsics", str(boards), "--board", "9x6", "--out", str(lens), "--json"]) in (0, 1)
    found = json.loads(capsys.readouterr().out)
    assert found["fx_px"] == pytest.approx(LENS.fx_px, abs=1.0) and found["cx_px"] == pytest.approx(LENS.cx_px, abs=1.0)
    for number in (1, 2):
        start_ns = START_NS + (number - 1) * 3600 * 10**9
        film = write_film(tmp_path / f"drive-{number}.mp4", left_m=0.4 * number)
        track = write_track(tmp_path / f"track-{number}.csv", start_ns=start_ns, left_m=0.4 * number)
        # The clock of the camera is 250 ms behind.
        run(
            *("recording", "new", "--poses", track, "--out", tmp_path / f"recordings/{number}"),
            *("--camera", f"front_wide={film}", "--lens", f"front_wide={lens}"),
            *("--mounting", "front_wide=0,0,1.4,0,0,0", "--start", f"front_wide={start_ns}"),
            *(
                "--time-offset-s",
                "front_wide=0.25",
                "--drive-id",
                f"drive-{number}",
                "--vehicle-id",
                "car-1",
                "--licence",
                "CC0",
            ),
        )
    assert (tmp_path / "recordings/2/videos/front_wide.mp4").samefile(film)
    said = capsys.readouterr().out
    assert "120 poses" in said and "23 of front_wide" in said
    dataset = tmp_path / "dataset"
    run("ingest", tmp_path / "recordings", "--roi", f"{LONGITUDE + 2.4e-4},{LATITUDE},60,street", "--out", dataset)
    assert main(["check", str(dataset), "--full"]) == 0, capsys.readouterr().out
    run("split", dataset, "mine", "--train", 1)
    protocol = ("--protocol", "static-reconstruction-unmasked")
    run(
        *("reconstruct", dataset, "--split", "mine", "--no-masks", "--steps", 3, "--width", 120, "--threads", 1),
        *("--set", "refinement.max_anchors=2000", "--out", tmp_path / "model"),
    )
    run("render", dataset, tmp_path / "model", "--split", "mine", *protocol, "--out", tmp_path / "submission")
    renders = [cv2.imread(str(file)) for file in sorted((tmp_path / "submission").rglob("*.png"))]
    assert renders and all(image is not None and np.isfinite(image).all() for image in renders)
    (row,) = json.loads((tmp_path / "recordings/1/calibrations/factory.json").read_text())
    assert row["time_offset_ns"] == 250_000_000
    first = (tmp_path / "recordings/1/videos/front_wide.csv").read_text().splitlines()[1]
    assert first == f"0,{START_NS + 250_000_000},{START_NS + 250_000_000}"
