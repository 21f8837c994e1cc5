"""Datasets made of real recordings: the rules find nothing that is not there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mirror.ingest.propose import propose_rois
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.integrity import CheckReport, Cost, check
from mirror.schema.documents import Roi


def found(report: CheckReport) -> set[str]:
    return {rule.rule_id for rule, _ in report.findings}


def test_boreas(real_data: Path, tmp_path: Path) -> None:
    loops = sorted((real_data / "boreas").glob("boreas-*"))
    rois = [one.roi for one in propose_rois(loops, count=2).ranked]
    ingest_recordings(loops, rois, tmp_path / "d")
    assert found(check(tmp_path / "d", cost=Cost.IMAGES)) == set()  # the reader states the licence of the data


def test_dgp(real_data: Path, tmp_path: Path) -> None:
    scene = real_data / "dgp_scene_02"
    options = IngestOptions(trigger={"min_duration_s": 0.1, "min_path_m": 1.0}, licence="MIT")
    ingest_recordings([scene], [propose_rois([scene], count=1, options=options).ranked[0].roi], tmp_path / "d", options)
    # Six cameras, boxes of a lidar, all of them in some image; faces and plates are as recorded.
    assert found(check(tmp_path / "d", cost=Cost.IMAGES)) == {"IMG009"}


def test_rsk(real_data: Path, tmp_path: Path) -> None:
    """Fixes that change every 13 s pass at `max_gap_s` of 30 and are gaps at the 2 s that a user may have meant."""
    drives = sorted((real_data / "rsk_twizy_t3").glob("*.csv"))
    options = IngestOptions(
        reader_options={"tz": "Africa/Casablanca", "date_format": "MM/DD/YYYY"}, trigger={"max_gap_s": 30.0},
        licence="CC BY 4.0",
    )  # fmt: skip
    roi = Roi(scene_id="corniche", longitude_deg=-6.7756, latitude_deg=33.9891)
    ingest_recordings(drives, [roi], tmp_path / "d", options)
    assert found(check(tmp_path / "d")) == set()
    document = (tmp_path / "d" / "dataset.json").read_text()
    (tmp_path / "d" / "dataset.json").write_text(document.replace('"max_gap_s": 30.0', '"max_gap_s": 2.0'))
    assert found(check(tmp_path / "d")) == {"POS005"}


def test_comma2k19(real_data: Path, tmp_path: Path) -> None:
    pyproj = pytest.importorskip("pyproj")
    route = next((real_data / "comma2k19" / "Example_1").iterdir())
    positions = np.load(route / "40" / "global_pose" / "frame_positions")
    lon, lat, _ = pyproj.Transformer.from_crs(4978, 4979, always_xy=True).transform(*positions[600])
    ingest_recordings([route], [Roi(scene_id="highway", longitude_deg=lon, latitude_deg=lat)], tmp_path / "d")
    assert found(check(tmp_path / "d", cost=Cost.IMAGES)) == set()
