"""Tests of the commands ``mirror synth`` and ``mirror demo``."""

import contextlib
import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import mirror.cli.main
from mirror.cli.demo import main as demo
from mirror.cli.main import main
from mirror.errors import ExitCode
from mirror.synth import Effects
from mirror.synth.fleet.drives import make_drives
from tests.leaderboard.results import result

PLAIN = ("--preset", "tiny", "--errors", "none", "--without", "noise,traffic,vignetting")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """One traversal without some effects and without errors, and what the verb printed."""
    out = tmp_path_factory.mktemp("verbs") / "fleet"
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert main(["synth", "--out", str(out), *PLAIN, "--traversals", "1", "--json"]) == 0
    return out, json.loads(printed.getvalue())


def test_synth_recordings_can_be_ingested(
    written: tuple[Path, dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    out, output = written
    assert [Path(path).parent for path in output["recordings"]] == [out, out]
    words = ["ingest", *output["recordings"], "--rois", output["rois"], "--dry-run", "--json"]
    assert main(words) == 0
    drives = json.loads(capsys.readouterr().out)["drives"]
    assert sorted(drive["accepted"] for drive in drives.values()) == [0, 1]
    assert main(["synth", "--out", str(out), *PLAIN]) == 2
    assert "recordings made with another --traversals" in capsys.readouterr().err


def test_without_switches_effects_off_by_name(
    written: tuple[Path, dict[str, Any]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, _ = written
    words = ["synth", "--out"]
    drive = make_drives("tiny", 0, traversals=1)[1][0]
    effects = Effects(noise=False, traffic=False, vignetting=False)
    shown = replace(drive, condition=replace(drive.condition, effects=effects))
    images = sorted((out / drive.drive_id / "images" / "front_wide").iterdir())
    image = cv2.imread(str(images[0]))
    stamp = int(images[0].stem)
    apart = [np.abs(image - one.render("front_wide", stamp).bgr.astype(int)).mean() for one in (shown, drive)]
    assert apart[0] < 0.75 * apart[1]
    assert main([*words, str(tmp_path / "other"), "--without", "noise,fog"]) == 2
    output = capsys.readouterr().err
    assert "no effect 'fog'" in output
    assert "motion_blur" in output
    assert not (tmp_path / "other").exists()
    assert main([*words, str(tmp_path / "other"), "--preset", "paper", "--without", "noise"]) == 2
    assert "take another preset" in capsys.readouterr().err
    for seed in ("-1", "99999999999999999999"):
        assert main([*words, str(tmp_path / "other"), "--seed", seed]) == 2
        assert f"--seed: {seed};" in capsys.readouterr().err


def test_demo_runs_its_commands_in_order_and_stops_at_the_first_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[list[str]] = []

    def run(words: list[str]) -> int:
        ran.append(words)
        if words[1] == "synth":
            for name in ("town-02", "town-01"):
                (tmp_path / "demo" / "recordings" / name).mkdir(parents=True)
        return 1 if words[1] == "check" else 0

    monkeypatch.setattr(mirror.cli.demo, "run", run)
    assert demo(["--out", str(tmp_path / "demo"), "--quick"]) == 1
    assert [words[:2] for words in ran] == [["mirror", verb] for verb in ("synth", "ingest", "split", "stats", "check")]
    recordings = tmp_path / "demo" / "recordings"
    assert ran[1][2:4] == [str(recordings / "town-01"), str(recordings / "town-02")]
    typed = [line for line in capsys.readouterr().out.splitlines() if line.startswith("$ ")]
    assert len(typed) == len(ran)
    assert f"$ mirror ingest {recordings}/*-*" in typed[1]


def test_demo_replaces_only_its_own_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[list[str]] = []
    floors = ["nearest_frame", "smoothed_nearest_frame", "grey_frame", "camera_mean", "mean_color"]
    scores = {"reconstructed": 17.5, **dict.fromkeys(floors, 11.0), "nearest_frame": 13.25, "results": 0.0}

    def record_command(words: list[str]) -> int:
        ran.append(words)
        if words[1] == "evaluate":
            out = Path(words[words.index("--out") + 1])
            figures = [
                {"metric": metric, "group": "novel", "value": scores[out.name] + more, "better": "higher", "n": 1}
                for metric, more in (("matched_structure", 0.0), ("psnr_invariant", 3.0))
            ]
            out.mkdir(parents=True)
            (out / "result.json").write_text(json.dumps({**result(), "figures": figures}))
        # The factory calibrations of the street have errors above the limit; the demo goes on.
        return int(ExitCode.FINDINGS if "--stage" in words else ExitCode.DONE)

    monkeypatch.setattr(mirror.cli.demo, "run", record_command)
    own = tmp_path / "own"
    assert demo(["--out", str(own)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "  reconstructed structure 17.500, invariant PSNR 20.50 dB on the held-out traversal" in lines
    assert "  nearest_frame structure 13.250, invariant PSNR 16.25 dB on the held-out traversal" in lines
    steps = [
        words[4] if words[1] == "baseline" else words[2] for words in ran if words[1] in ("baseline", "leaderboard")
    ]
    street = ["nearest_frame", "add", "mean_color", "add"]
    # The board, which is built last, also lists the block, all floors on it, and the drives of the short suite.
    block = [*floors, *["add"] * 6, "add", "build"]
    assert steps == [*street, *block]
    verbs = [words[1] for words in ran]
    assert verbs.index("reconstruct") < verbs.index("render") < verbs.index("compare")
    checks = [words[3:] for words in ran if words[1] == "calibrate"]
    drive = own / "calibration"
    assert checks == [
        [str(drive / "dataset"), "--out", str(drive / "online")],
        [str(drive / "dataset"), "--stage", "factory", "--out", str(drive / "factory")],
    ]
    (own / "old.txt").write_text("from the last demo")
    assert demo(["--out", str(own)]) == 0
    assert not (own / "old.txt").exists()
    # The demo reports findings if its reconstruction does not beat the nearest frame.
    scores["reconstructed"] = 13.0
    assert demo(["--out", str(own)]) == ExitCode.FINDINGS
    other = tmp_path / "other"
    other.mkdir()
    (other / "letter.txt").write_text("mine")
    monkeypatch.undo()
    assert main(["demo", "--out", str(other)]) == 2
    assert "a folder with other files" in capsys.readouterr().err
    assert (other / "letter.txt").read_text() == "mine"
