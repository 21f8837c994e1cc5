"""`mirror recording new`: JPEGs and a GPX track, all faults at once, clocks that do not agree."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.cli.main import main
from mirror.geometry.cameras import Camera
from mirror.recordings.lens_files import write_lens
from mirror.recordings.registry import open_recording
from tests.builders.small_folder import write_image
from tests.recordings.assembly.street import START_NS, write_track
from tests.recordings.assembly.tracks import GPX


@pytest.fixture
def images(tmp_path: Path) -> Path:
    for step in range(4):
        write_image(tmp_path / "front" / f"{START_NS + step * 50_000_000}.jpg")
    return tmp_path / "front"


def test_jpegs_and_a_gpx_track(tmp_path: Path, images: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.gpx").write_text(GPX.replace("52.5001", "52.5"))
    out = tmp_path / "recording"
    words = ["recording", "new", "--poses", str(tmp_path / "a.gpx"), "--out", str(out), "--rig-id", "two"]
    words += ["--camera", f"front_wide={images}", "--camera", f"rear={images}", "--time-offset-s", "rear=0.05"]
    assert main(words) == 0
    said = capsys.readouterr().out
    for part in ("direction of travel", "sea level", "standstill", "names of the files", "no lens"):
        assert part in said, part
    recording = open_recording(out)
    assert recording.rig is not None and recording.rig.rig_id == "two"
    assert [camera.is_calibrated for camera in recording.rig.cameras] == [False, False]
    streams = recording.images()
    np.testing.assert_array_equal(
        streams["rear"].exposure_start_ns - streams["front_wide"].exposure_start_ns, 50_000_000
    )
    first = streams["front_wide"].path(0)
    assert first is not None and Path(first).samefile(images / f"{START_NS}.jpg")
    assert recording.track().timestamp_ns.tolist() == [START_NS, START_NS + 250_000_000]
    # The folder is a recording now, and is not written again.
    assert main(words) == 2


def test_all_faults_are_listed_at_once(tmp_path: Path, images: Path, capsys: pytest.CaptureFixture[str]) -> None:
    track, lens = write_track(tmp_path / "track.csv"), tmp_path / "lens.yaml"
    write_lens(lens, Camera("pinhole", 640, 480, 400.0, 400.0, 320.0, 240.0))
    words = ["recording", "new", "--poses", str(track), "--out", str(tmp_path / "out"), "--reference-camera", "left"]
    words += ["--camera", f"front={images}", "--lens", f"front={lens}", "--mounting", "front=0,0,1,0,0,0"]
    words += ["--camera", f"rear={tmp_path / 'absent'}", "--drive-id", "a b"]
    assert main(words) == 2
    said = capsys.readouterr().err
    for part in ("640 x 480", "absent", "'left'", "'a b'"):
        assert part in said, part
    assert not (tmp_path / "out").exists()
    for wrong in (["--lens", "side=x.yaml"], ["--camera", "front"], ["--time-offset-s", "front=soon"]):
        assert main([*words[:6], "--camera", f"front={images}", *wrong]) == 2


def test_a_mask_of_the_vehicle_has_the_size_of_the_images(
    tmp_path: Path, images: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    size = cv2.imread(str(next(images.iterdir()))).shape[:2]
    drawn = np.zeros(size, np.uint8)
    drawn[-5:] = 255
    cv2.imwrite(str(tmp_path / "bonnet.png"), drawn)
    cv2.imwrite(str(tmp_path / "small.png"), drawn[::2])
    track = write_track(tmp_path / "track.csv")
    words = ["recording", "new", "--poses", str(track), "--camera", f"front={images}", "--out", str(tmp_path / "out")]
    for name, said in (("small.png", f"{size[1]} x {size[0] // 2 + size[0] % 2} px"), ("absent.png", "is missing")):
        assert main([*words, "--static-mask", f"front={tmp_path / name}"]) == 2
        assert said in (refused := capsys.readouterr().err) and "--static-mask front=" in refused
    assert main([*words, "--static-mask", f"front={tmp_path / 'bonnet.png'}"]) == 0
    rig = open_recording(tmp_path / "out").rig
    assert rig is not None and rig.cameras[0].static_mask is not None
    np.testing.assert_array_equal(rig.cameras[0].static_mask, drawn)


def test_clocks_that_do_not_agree_are_refused(tmp_path: Path, images: Path, capsys: pytest.CaptureFixture[str]) -> None:
    track = write_track(tmp_path / "track.csv", start_ns=START_NS + 3600 * 10**9)
    words = ["recording", "new", "--poses", str(track), "--camera", f"front={images}", "--out", str(tmp_path / "out")]
    assert main([*words, "--json"]) == 2
    assert "3,600.0 s before" in capsys.readouterr().err
    assert main([*words, "--time-offset-s", "front=3600", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["images"] == {"front": 4}
