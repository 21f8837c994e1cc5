"""The summary of a recording, against the numbers that it was written with."""

from __future__ import annotations

from pathlib import Path

import pytest

from mirror.recordings.registry import open_recording
from mirror.recordings.summary import summarise
from tests.builders.small_folder import START_NS, write_recording


def test_images_are_summarised_at_mid_exposure(tmp_path: Path) -> None:
    """Exposures of different lengths: starts are 80 and 110 ms apart, middles 100 ms."""
    starts_ms, ends_ms = (0, 80, 190), (20, 140, 230)
    path = write_recording(tmp_path, images=["a.jpg", "b.jpg", "c.jpg"])
    rows = [
        f"{name}.jpg,{START_NS + start * 10**6},{START_NS + end * 10**6}\n"
        for name, start, end in zip("abc", starts_ms, ends_ms)
    ]
    (path / "images" / "front_wide.csv").write_text("file,exposure_start_ns,exposure_end_ns\n" + "".join(rows))
    camera = summarise(open_recording(path)).cameras["front_wide"]
    assert (camera.images, camera.codec) == (3, "jpeg")
    assert camera.first_ns == START_NS + 10 * 10**6
    assert camera.last_ns == START_NS + 210 * 10**6
    assert camera.rate_hz == pytest.approx(10.0)
