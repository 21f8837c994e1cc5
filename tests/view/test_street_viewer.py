"""The viewer of a street: what it moves along, and a headless browser that shows its images and follows its sliders."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.view.street_path import StreetPath, blend, by_light, read_path
from tests.leaderboard.browser import Browser
from tests.view.flat import COLOURS, DAY, NIGHT, Flat


@pytest.fixture(scope="module")
def path(street: Dataset) -> StreetPath:
    return read_path(street, DAY)


def test_a_path_has_the_poses_of_its_images(street: Dataset, path: StreetPath) -> None:
    assert (path.camera, len(path.images)) == ("front_wide", 5)
    view = path.view(2, 480, 270)
    expected = street.where(traversal=DAY).frames()[2].images["front_wide"].world_SE3_camera
    np.testing.assert_allclose(view.pose.matrix(), expected.matrix(), atol=1e-12)
    lens = path.images[2].camera_model
    assert view.fy_px / view.height_px == pytest.approx(max(lens.fy_px / lens.height_px, 0.5 / np.tan(0.48)))
    # A shift is to the left of the vehicle: along the ego's y.
    ego = street.where(traversal=DAY).frames()[2].world_SE3_ego
    moved = path.view(2, 480, 270, left_m=2.0).pose.translation[0] - view.pose.translation[0]
    np.testing.assert_allclose(moved, 2.0 * ego.matrix()[0, :3, 1], atol=1e-9)
    with pytest.raises(UsageError, match="no image of camera 'side'"):
        read_path(street, DAY, "side")


def test_appearances_go_from_day_to_night() -> None:
    ordered = by_light(Flat.appearances)
    assert [item.light for item in ordered] == ["day", "night"]
    assert blend(ordered, 0.0) == {DAY: 1.0}
    assert blend(ordered, 0.25) == {DAY: 0.75, NIGHT: 0.25}
    assert blend(ordered, 1.0) == {NIGHT: 1.0}
    assert blend(ordered, 7.0) == {NIGHT: 1.0}
    assert blend(ordered[:1], 0.5) == {DAY: 1.0}


def middle_colour(browser: Browser, file: Path) -> np.ndarray:
    browser.screenshot(file, whole=False)
    pixels = cv2.imread(str(file))[..., ::-1]
    height = pixels.shape[0]
    return np.median(pixels[height // 3 : 2 * height // 3, 160:320].reshape(-1, 3), axis=0)


def wait_for(browser: Browser, file: Path, colour: tuple[float, ...], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while np.abs(middle_colour(browser, file) - colour).max() > 12.0:
        assert time.monotonic() < end, (middle_colour(browser, file), colour)
        time.sleep(0.3)


def test_a_browser_shows_images_and_follows_the_sliders(path: StreetPath, browser: Browser, tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="the extra view is not installed")
    from mirror.view.street_viewer import MOVING_PX, StreetViewer, ViewerOptions

    renderer = Flat()
    viewer = StreetViewer(renderer, path, ViewerOptions(port=0))
    try:
        browser.call("Emulation.setDeviceMetricsOverride", width=640, height=360, deviceScaleFactor=1, mobile=False)
        browser.call("Page.navigate", url=viewer.url)
        while browser.script("document.readyState") != "complete" or browser.script("location.href") == "about:blank":
            time.sleep(0.1)
        wait_for(browser, tmp_path / "day.png", COLOURS[DAY])
        viewer.appearance.value = 1.0
        wait_for(browser, tmp_path / "night.png", COLOURS[NIGHT])
        # What is still is rendered in full: the browser's own height.
        end = time.monotonic() + 30.0
        while renderer.views[-1][1]:
            assert time.monotonic() < end
            time.sleep(0.1)
        still, moved = renderer.views[-1][0], next(view for view, moving in renderer.views if moving)
        assert still.height_px > moved.height_px == MOVING_PX
        # The slider of time moves the camera to that image's place.
        viewer.time.value = 4
        viewer.left.value = 3.0
        expected = path.view(4, 480, 270, left_m=3.0)
        end = time.monotonic() + 30.0
        while np.linalg.norm(renderer.views[-1][0].pose.translation - expected.pose.translation) > 1e-3:
            assert time.monotonic() < end, renderer.views[-1][0].pose.translation
            time.sleep(0.1)
        found = renderer.views[-1][0]
        np.testing.assert_allclose(found.pose.matrix()[0, :3, 2], expected.pose.matrix()[0, :3, 2], atol=1e-3)
        assert found.fy_px / found.height_px == pytest.approx(expected.fy_px / 270, rel=1e-3)
    finally:
        viewer.close()


def test_the_verb_refuses_a_model_in_place_of_a_dataset(
    street: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "reconstruction.json").write_text("{}")
    assert main(["view", str(tmp_path / "model")]) == 2
    assert f"Remedy: mirror view DATASET {tmp_path / 'model'}" in capsys.readouterr().err
    assert main(["view", street.root, str(tmp_path / "model"), "--save", "x.rrd"]) == 2
    assert main(["view", street.root, "--save", str(tmp_path / "x.txt")]) == 2
    assert main(["view", street.root, "--every", "0"]) == 2
