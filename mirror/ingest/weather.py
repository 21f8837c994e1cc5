"""Weather of traversals whose source does not state it: asked of a plug-in, from a few pictures of each."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from mirror.arrays import UInt8
from mirror.dataset.layout import Layout
from mirror.errors import RecordingError
from mirror.ingest.judge import JudgedDrive
from mirror.recordings.weather import weather_from_pictures
from mirror.schema.files import read_table
from mirror.schema.tables import IMAGES

_PICTURES = 3


def weather_from_traversals(
    layout: Layout, drive: JudgedDrive, traversal_ids: Sequence[str | None], plugin: str
) -> dict[int, str]:
    """Weather by number of pass, for accepted passes with pictures of a drive whose source does not state it.

    Args:
        layout: the dataset, with the traversals written.
        drive: judged.
        traversal_ids: one for each pass, None for the refused.
        plugin: the plug-in's name.
    """
    rig = drive.recording.rig
    if drive.info.weather is not None or rig is None:
        return {}
    labels = {}
    for number, name in enumerate(traversal_ids):
        if name is None:
            continue
        rows = read_table(layout.recorded(name) / "images.parquet", IMAGES, ["camera", "uri"]).to_pylist()
        uris = [row["uri"] for row in rows if row["camera"] == rig.reference_camera]
        if uris:
            chosen = sorted({round(index) for index in np.linspace(0, len(uris) - 1, _PICTURES)})
            labels[number] = weather_from_pictures(plugin, [_decode(layout, uris[index]) for index in chosen])
    return labels


def _decode(layout: Layout, uri: str) -> UInt8:
    picture = cv2.imread(str(layout.root / uri), cv2.IMREAD_COLOR_RGB)
    if picture is None:
        raise RecordingError(
            "cannot be decoded", file=layout.root / uri, expected="a JPEG or PNG", remedy="restore the picture"
        )
    return np.asarray(picture, np.uint8)
