"""Covariances of calibrations: covariances of random samples are accepted, invalid ones are refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mirror.dataset.layout import Layout
from mirror.errors import RecordingError
from mirror.ingest.passes import find_drive_passes, fingerprint
from mirror.ingest.staging import Staging
from mirror.ingest.traversal import WriteOptions, write_traversal
from mirror.ingest.trigger import RoiTrigger
from mirror.recordings.calibration import Calibration, require_covariance, to_calibration_table
from mirror.recordings.folder_document import read_document
from mirror.recordings.readers.folder import FolderRecording
from mirror.recordings.registry import open_recording
from mirror.schema.documents import CleaningOptions, TriggerOptions
from mirror.schema.tables import CALIBRATIONS
from tests.builders.folder import SCENE
from tests.builders.folder import write_recording as write_drive
from tests.builders.small_folder import CALIBRATION, write_recording

SIGMA = np.array([1e-3, 2e-3, 5e-4, 0.02, 0.01, 0.05])


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.sampled_from([4, 6, 17]))
def test_sample_covariances_are_accepted(seed: int, samples: int, digits: int) -> None:
    """The matrix of few samples is singular, and rounding makes it slightly indefinite."""
    draws = np.random.default_rng(seed).normal(size=(samples, 6)) * SIGMA
    covariance = draws.T @ draws / samples
    require_covariance(np.array([float(f"{value:.{digits - 1}e}") for value in covariance.ravel()]))


def test_covariances_of_any_scale_are_accepted() -> None:
    """Variances of 1e-20 beside those of 1e6, and an axis that is known exactly."""
    require_covariance(np.diag([1e-20, 1e-20, 0.0, 1e6, 1.0, 0.0]).ravel())


def asymmetric(covariance: np.ndarray) -> None:
    covariance[0, 3] += 0.1 * SIGMA[0] * SIGMA[3]


def indefinite(covariance: np.ndarray) -> None:
    covariance[4, 5] = covariance[5, 4] = 1.01 * SIGMA[4] * SIGMA[5]


def triangle(covariance: np.ndarray) -> None:
    """Each pair of axes is valid, but the three axes together are not."""
    for i, j, sign in ((0, 1, 1), (1, 2, 1), (0, 2, -1)):
        covariance[i, j] = covariance[j, i] = sign * 0.8 * SIGMA[i] * SIGMA[j]


def negative(covariance: np.ndarray) -> None:
    covariance[2, 2] = -1e-12


def without_variance(covariance: np.ndarray) -> None:
    covariance[1, 1] = 0.0
    covariance[1, 2] = covariance[2, 1] = 1e-9


SPOILED = {
    asymmetric: "not symmetric",
    indefinite: "not positive semi-definite",
    triangle: "not positive semi-definite",
    negative: "variance -1e-12 at row 2",
    without_variance: "not positive semi-definite",
}


@pytest.mark.parametrize("spoil", SPOILED)
def test_invalid_covariances_are_refused(spoil: object, tmp_path: Path) -> None:
    covariance = np.diag(SIGMA**2)
    spoil(covariance)  # type: ignore[operator]
    path = write_recording(tmp_path / "drive")
    (path / "calibrations").mkdir()
    entry = CALIBRATION | {"covariance": covariance.ravel().tolist()}
    (path / "calibrations" / "factory.json").write_text(json.dumps([CALIBRATION, entry]))
    with pytest.raises(RecordingError, match=SPOILED[spoil]) as caught:  # type: ignore[index]
        open_recording(path).calibrations()
    assert caught.value.file is not None and caught.value.file.endswith("factory.json")
    assert caught.value.place is not None and caught.value.place.startswith("1")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused(value: float) -> None:
    covariance = np.diag(SIGMA**2)
    covariance[3, 3] = value
    with pytest.raises(ValueError, match="not finite"):
        require_covariance(covariance.ravel())
    with pytest.raises(ValueError, match="has 35 values"):
        require_covariance(np.zeros(35))


def test_a_calibration_keeps_its_covariance() -> None:
    calibration = Calibration.model_validate(CALIBRATION | {"covariance": np.diag(SIGMA**2).ravel().tolist()})
    table = to_calibration_table([("factory", calibration)], vehicle_id="car", drive_id="drive")
    assert isinstance(table, pa.Table)
    np.testing.assert_array_equal(np.reshape(table.column("covariance")[0].as_py(), (6, 6)), np.diag(SIGMA**2))


def test_ingest_refuses_invalid_covariances_of_any_reader(tmp_path: Path) -> None:
    """A third-party reader may give any table of calibrations."""

    class Third(FolderRecording):
        def calibrations(self) -> pa.Table:
            covariance = np.diag(SIGMA**2)
            asymmetric(covariance)
            rows = super().calibrations().to_pylist()
            return pa.Table.from_pylist(
                [row | {"covariance": covariance.ravel().tolist()} for row in rows], schema=CALIBRATIONS.schema
            )

    path = write_drive(tmp_path, "drive")
    recording = Third(path, read_document(path / "recording.json"))
    options = TriggerOptions()
    trigger = RoiTrigger([SCENE], options, CleaningOptions())
    source = fingerprint(recording, "third", "drive")
    drive = find_drive_passes(path, recording, source, trigger, [SCENE], CleaningOptions())
    (number,) = drive.slices
    staging = Staging(Layout(tmp_path / "d"))
    with pytest.raises(RecordingError, match="not symmetric") as caught:
        write_traversal(staging, drive, number, SCENE, "", WriteOptions(), 1, lambda _: None)
    assert caught.value.place == "calibration 0, camera front_wide"
    assert not any((tmp_path / "d").rglob("manifest.json"))
