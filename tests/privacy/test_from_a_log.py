"""From logs of messages to a published dataset, by commands alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.cli.main import main
from tests.builders.folder import LAT, LON
from tests.recordings.readers.message_logs.drives import ONE
from tests.recordings.readers.message_logs.writer import messages, write_mcap


def test_logs_are_ingested_redacted_released_published_and_fetched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("logs").mkdir()
    for number, day in enumerate(("monday", "tuesday")):
        later, images = number * 86_400 * 10**9, []
        for index in range(len(ONE.images)):
            pixels = np.full((48, 64, 3), 60 + 10 * index + 5 * number, np.uint8)
            # The mark that the tests' detector takes for a plate.
            pixels[20:30, 20:36] = (255, 0, 0)
            images.append(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes())
        drive = replace(ONE, stamps=ONE.stamps + later, image_stamps=ONE.image_stamps + later, images=images)
        log = write_mcap(Path(f"logs/{day}.mcap"), messages(drive))
        assert main(["info", str(log)]) == 0
        log.with_suffix(".toml").write_text(
            capsys.readouterr().out.replace('vehicle_id = "unknown"', 'vehicle_id = "car_1"')
        )
    for words in (
        f"ingest logs --roi {LON},{LAT},150,street --licence CC0-1.0 --out dataset",
        "check dataset",
        "deidentify dataset --plate-region XX --detector faces --detector plates --workers 1",
        "release build dataset --out release --name street --licence CC0-1.0 --contact a@example.org --sample 0",
        "release check release --originals dataset",
        "split release novel --train 1 --held-out-traversals 1",
    ):
        assert main(words.split()) == 0, (words, capsys.readouterr())
    capsys.readouterr()
    assert main(["dataset", "publish", "release", "--split", "novel", "--no-masks", "--out", "published"]) == 0
    assert "as recorded" not in capsys.readouterr().out
    assert main(["dataset", "fetch", "published", "--out", "street"]) == 0
    train = [image for image in mirror.open("street").frames() for image in image.images.values()]
    shown = [image for image in train if not image.is_withheld]
    assert shown and len(shown) < len(train)
    for image in shown:
        # Where the plate was, nothing of its blue is left.
        assert image.decode()[22:28, 23:33, 2].max() < 250
