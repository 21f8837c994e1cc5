"""The generators whose output folders can be read, and how each names and crops its images.

| generator | writes |
|---|---|
| OpenDWM, ``export_generation_result_as_nuscenes_data.py`` | ``samples/CAM_FRONT/LOG__CAM_FRONT__MICROSECONDS.jpg``, and ``sweeps`` |
| MagicDrive-V2, ``test_magicdrive.py``, ``save_mode=image_filename`` | ``gen_video/CAM_FRONT/LOG__CAM_FRONT__MICROSECONDS_gen0.jpg`` |
| MagicDrive-V2, ``save_mode=single-view`` | ``gen_video/TOKEN_gen0/TOKEN_CAM_FRONT.mp4`` |
| DriveEditor, ``interactive_gui.py`` | one video of one camera for each edit |
"""  # noqa: E501

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from mirror.evaluation.submission.manifest import Appearance, SubmittedMethod

APPEARANCE: Final = Appearance(policy="other", description="generated from reference frames, layout or text")


@dataclass(frozen=True)
class Generator:
    """A generator whose output can be read.

    Attributes:
        method: entry of the manifest.
        image_name: pattern of the stem of an image's file, with the groups ``channel``, ``us`` and, where several
            samples are drawn, ``sample``; None: the generator writes videos only.
        videos: whether it writes videos, whose place in the dataset a table of clips states.
        lower_part: whether the images may show the lower part of what was recorded, in its full width.
    """

    method: SubmittedMethod
    image_name: re.Pattern[str] | None
    videos: bool
    lower_part: bool = False


_NUSCENES: Final = r".+__(?P<channel>CAM_[A-Z0-9_]+)__(?P<us>\d{16})"

GENERATORS: Final[Mapping[str, Generator]] = MappingProxyType(
    {
        "opendwm": Generator(
            SubmittedMethod(name="OpenDWM", url="https://github.com/SenseTime-FVG/OpenDWM", licence="MIT"),
            re.compile(_NUSCENES),
            videos=False,
        ),
        "magicdrive-v2": Generator(
            SubmittedMethod(name="MagicDrive-V2", url="https://github.com/flymin/MagicDrive-V2", licence="AGPL-3.0"),
            re.compile(_NUSCENES + r"_gen(?P<sample>\d+)"),
            videos=True,
            # 848 x 1600 pixels of 900 x 1600: the upper rows are cut off.
            lower_part=True,
        ),
        "driveeditor": Generator(
            SubmittedMethod(name="DriveEditor", url="https://github.com/yvanliang/DriveEditor", licence="not stated"),
            None,
            videos=True,
        ),
    }
)
