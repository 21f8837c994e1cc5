"""Images of a phone on a drive."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.calibration.corridor import corridor
from tests.localisation.phone_drive import IMAGES, START_NS, STEP_NS, drive, mounted


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("images")
    cameras = mounted(drive())
    for number in range(IMAGES):
        file = folder / f"{START_NS + number * STEP_NS}.png"
        file.write_bytes(corridor(cameras[np.array([number])]))
    return folder
