"""Photos and a COLMAP model as a recording: several cameras, any order, no places, and what is refused."""

from __future__ import annotations

import json
import runpy
import zlib  # noqa: F401 - before pycolmap, whose wheel brings one of its own
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mirror
from mirror.arrays import Float64
from mirror.cli.main import main as run
from mirror.errors import ExitCode, UsageError
from mirror.geometry.geodesy import ecef_R_enu, ecef_to_geodetic, geodetic_to_ecef
from mirror.recordings.registry import open_recording
from tests.conftest import ROOT

pycolmap = pytest.importorskip("pycolmap")
Image = pytest.importorskip("PIL.Image")

LONGITUDE, LATITUDE, HEIGHT_M = 13.19, -33.7, 40.0
METRES_A_UNIT = 7.5
COUNT = 12
CAMERAS: dict[int, tuple[str, int, int, list[float]]] = {
    1: ("SIMPLE_RADIAL", 64, 48, [50.0, 32.0, 24.0, -0.1]),
    2: ("OPENCV_FISHEYE", 48, 48, [20.0, 21.0, 24.0, 24.5, 0.01, 0.02, 0.03, 0.04]),
    3: ("FULL_OPENCV", 64, 48, [30.0, 31.0, 20.0, 32.0, 0.1, 0.2, 1e-3, 2e-3, 0.3, 0.4, 0.5, 0.6]),
}
EXPECTED = {
    1: ("brown_conrady", 50.0, 50.0, [-0.1, 0.0, 0.0, 0.0, 0.0]),
    2: ("kannala_brandt", 20.0, 21.0, [0.01, 0.02, 0.03, 0.04]),
    3: ("rational", 30.0, 31.0, [0.1, 0.2, 1e-3, 2e-3, 0.3, 0.4, 0.5, 0.6]),
}


def convert(folder: Path, out: Path, **options: Any) -> None:
    """Do what the example does, with these words."""
    runpy.run_path(str(ROOT / "examples" / "lund_recording.py"))["main"](folder, out, **options)


class Photos:
    """Photos of a walk along a street, and their model.

    Args:
        folder: a new one.
        order: of the walk, by name.
        cameras: of each photo.
        placed: which photos hold a place.
    """

    def __init__(self, folder: Path, order: list[int], cameras: list[int], placed: list[int]) -> None:
        self.folder, self.cameras = folder, [cameras[place] for place in order]
        along = 4.0 * np.arange(COUNT, dtype=np.float64)
        truth = np.stack([along, 3.0 * np.sin(0.1 * along), 1.6 + 0.02 * along], axis=1)
        self.truth: Float64 = truth[order]  # east, north, up, metres, in the order of the names
        (folder / "images").mkdir(parents=True)
        (folder / "colmap").mkdir()
        self.names = [f"{number:02}.jpg" for number in range(COUNT)]
        for number, place in enumerate(order):
            self.save(number, place in placed)
        self.write(self.model())

    def model(self) -> Any:
        """The model, in axes and units of its own."""
        turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
        turn *= np.linalg.det(turn)
        model = pycolmap.Reconstruction()
        for number in sorted(set(self.cameras)):
            kind, width, height, params = CAMERAS[number]
            model.add_camera_with_trivial_rig(
                pycolmap.Camera(camera_id=number, model=kind, width=width, height=height, params=params)
            )
        for number, (name, camera) in enumerate(zip(self.names, self.cameras)):
            enu_R_camera = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # looking east
            rotation = enu_R_camera.T @ turn.T
            centre = turn @ self.truth[number] / METRES_A_UNIT + [3.0, -1.0, 2.0]
            pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ centre)
            image = pycolmap.Image(name=name, points2D=np.empty((0, 2)), camera_id=camera, image_id=number + 1)
            model.add_image_with_trivial_frame(image, pose)
        return model

    def write(self, model: Any) -> None:
        """Keep a model."""
        model.write(str(self.folder / "colmap"))

    def save(self, number: int, placed: bool, size: tuple[int, int] | None = None) -> None:
        """Write a photo of one grey."""
        _, width, height, _ = CAMERAS[self.cameras[number]]
        photo, exif = Image.new("L", size or (width, height), 20 * number), Image.Exif()
        if placed:
            origin, turn = geodetic_to_ecef(LONGITUDE, LATITUDE, HEIGHT_M), ecef_R_enu(LONGITUDE, LATITUDE)
            lon, lat, height_m = (float(v[0]) for v in ecef_to_geodetic((origin + turn @ self.truth[number])[None]))
            exif[34853] = {
                1: "S", 2: (abs(lat), 0.0, 0.0), 3: "E", 4: (int(lon), (lon % 1) * 60.0, 0.0), 6: height_m,
            }  # fmt: skip
        photo.save(self.folder / "images" / self.names[number], exif=exif)

    def distances(self) -> Float64:
        """Metres from each photo to the next."""
        found: Float64 = np.linalg.norm(np.diff(self.truth[:, :2], axis=0), axis=1)
        return found


@pytest.fixture
def mixed(tmp_path: Path) -> Photos:
    """Photos of three cameras, in no order, five of them with a place."""
    order = np.random.default_rng(2).permutation(COUNT).tolist()
    return Photos(tmp_path / "mixed", order, [1 + number % 3 for number in range(COUNT)], [0, 3, 5, 8, 11])


def test_each_photo_keeps_its_lens_and_its_place(mixed: Photos, tmp_path: Path) -> None:
    convert(mixed.folder, tmp_path / "recordings")
    origin, turn = geodetic_to_ecef(LONGITUDE, LATITUDE, HEIGHT_M), ecef_R_enu(LONGITUDE, LATITUDE)
    found = 0
    for folder, cameras in (("64x48", (1, 3)), ("48x48", (2,))):
        photos = [number for number, camera in enumerate(mixed.cameras) if camera in cameras]
        found += len(photos)
        recording = open_recording(tmp_path / "recordings" / folder)
        track = recording.track()
        assert len(track) == len(photos)
        assert track.longitude_deg is not None and track.latitude_deg is not None and track.height_m is not None
        enu = (geodetic_to_ecef(track.longitude_deg, track.latitude_deg, track.height_m) - origin) @ turn
        # cameras of phones round places; these are exact to the rationals of EXIF
        assert np.abs(enu[:, :2] - mixed.truth[photos, :2]).max() < 0.05
        assert np.ptp(enu[:, 2] - mixed.truth[photos, 2]) < 0.01

        rows = recording.calibrations().to_pylist()
        lowest, highest = -(2**63), 2**63 - 1
        for stamp, photo in zip(track.timestamp_ns.tolist(), photos, strict=True):
            camera = mixed.cameras[photo]
            (row,) = (
                row for row in rows if (row["valid_from_ns"] or lowest) <= stamp <= (row["valid_to_ns"] or highest)
            )
            assert (row["width_px"], row["height_px"]) == CAMERAS[camera][1:3]
            assert (row["model"], row["fx_px"], row["fy_px"], row["distortion"]) == EXPECTED[camera]
            copied = tmp_path / "recordings" / folder / "images" / "front_wide" / f"{stamp}.jpg"
            assert copied.read_bytes() == (mixed.folder / "images" / mixed.names[photo]).read_bytes()
    assert found == COUNT


def test_a_dataset_is_made_of_all_of_them(mixed: Photos, tmp_path: Path) -> None:
    convert(mixed.folder, tmp_path / "recordings")
    roi = f"{LONGITUDE + 0.0002},{LATITUDE}"
    recordings = map(str, sorted((tmp_path / "recordings").iterdir()))
    words = [*recordings, "--roi", roi, "--min-duration-s", "1", "--out", str(tmp_path / "dataset")]
    assert run(["ingest", *words]) == ExitCode.DONE
    dataset = mirror.open(tmp_path / "dataset")
    assert len(dataset.traversals()) == 2
    assert dataset.table("images", ["frame_index"]).column(0).null_count == 0
    assert dataset.table("images", ["frame_index"]).num_rows == COUNT
    assert run(["check", str(tmp_path / "dataset")]) == ExitCode.DONE


def test_photos_without_places_are_refused_or_in_a_local_frame(tmp_path: Path) -> None:
    photos = Photos(tmp_path / "photos", list(range(COUNT)), [1] * COUNT, [])
    with pytest.raises(UsageError, match="0 photos have a place") as caught:
        convert(photos.folder, tmp_path / "recording")
    assert "--metres-per-unit" in str(caught.value.remedy)
    assert not list(tmp_path.glob("recording*"))
    convert(photos.folder, tmp_path / "recording", metres_per_unit=METRES_A_UNIT)
    recording = open_recording(tmp_path / "recording")
    track = recording.track()
    assert track.x_m is not None and track.y_m is not None
    apart = np.hypot(np.diff(track.x_m), np.diff(track.y_m))
    np.testing.assert_allclose(apart, photos.distances(), atol=1e-6)
    document = json.loads((tmp_path / "recording" / "recording.json").read_text())
    assert document["frame"] == {"kind": "local", "name": "colmap"}


def _other_lens(photos: Photos) -> None:
    model = photos.model()
    model.cameras[1].model = "FOV"
    model.cameras[1].params = [50.0, 50.0, 32.0, 24.0, 0.1]
    photos.write(model)


def _as_png(photos: Photos) -> None:
    photos.names[3] = "03.png"
    photos.save(3, True)
    photos.write(photos.model())


def _upside_down(photos: Photos) -> None:
    model = photos.model()
    half = pycolmap.Rigid3d(pycolmap.Rotation3d(np.diag([-1.0, -1.0, 1.0])), np.zeros(3))
    for number in range(1, COUNT, 2):
        frame = model.frames[model.images[number].frame_id]
        frame.rig_from_world = half * frame.rig_from_world
    photos.write(model)


def _no_model(photos: Photos) -> None:
    for file in (photos.folder / "colmap").iterdir():
        file.unlink()


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (
            lambda photos: (photos.folder / "images" / "04.jpg").unlink(),
            "1 of 12 photos of the model are missing: 04.jpg",
        ),
        (lambda photos: photos.save(4, True, (48, 64)), "04.jpg: 48 x 64 pixels; expected 64 x 48"),
        (lambda photos: [photos.save(number, number == 4) for number in range(COUNT)], "1 photos have a place"),
        (_other_lens, "camera 1 is FOV"),
        (_as_png, "photos are .jpg, .png"),
        (_upside_down, "no up in common"),
        (_no_model, "no model can be read"),
    ],
)
def test_what_makes_no_recording_is_refused_by_name(
    change: Callable[[Photos], None], match: str, tmp_path: Path
) -> None:
    photos = Photos(tmp_path / "photos", list(range(COUNT)), [1] * COUNT, list(range(COUNT)))
    change(photos)
    with pytest.raises(UsageError) as caught:
        convert(photos.folder, tmp_path / "recording")
    assert match in str(caught.value)
    assert not list(tmp_path.glob("recording*"))


def test_what_is_there_is_not_written_over(tmp_path: Path) -> None:
    photos = Photos(tmp_path / "photos", list(range(COUNT)), [1] * COUNT, list(range(COUNT)))
    convert(photos.folder, tmp_path / "recording")
    before = (tmp_path / "recording" / "poses.csv").read_bytes()
    with pytest.raises(UsageError, match="is there already"):
        convert(photos.folder, tmp_path / "recording")
    assert (tmp_path / "recording" / "poses.csv").read_bytes() == before


def test_photos_of_other_lenses_are_not_trained_on_with_the_wrong_one(mixed: Photos) -> None:
    pytest.importorskip("torch")
    load = runpy.run_path(str(ROOT / "examples" / "photos.py"))["load"]
    with pytest.raises(UsageError, match="FULL_OPENCV") as caught:
        load(mixed.folder, 64)
    assert "SIMPLE_RADIAL" in str(caught.value.expected)
