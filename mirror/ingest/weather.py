"""Weather of traversals whose source does not state it: asked of a plug-in, from a few images of each."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from mirror.arrays import UInt8
from mirror.dataset.store import Store
from mirror.errors import RecordingError
from mirror.ingest.passes import DrivePasses
from mirror.ingest.staging import Staging
from mirror.recordings.raster import is_decodable
from mirror.recordings.weather import classify_weather
from mirror.schema.files import read_table
from mirror.schema.tables import IMAGES

_IMAGES = 3


def weather_from_traversals(
    staging: Staging, drive: DrivePasses, traversal_ids: Sequence[str | None], plugin: str
) -> dict[int, str]:
    """Return the weather by number of pass, for accepted passes with images of a drive whose source does not state it.

    Args:
        staging: the dataset, with the traversals written.
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
        folder = staging.recorded(name)
        # Where the traversal lies now, its uris are relative to.
        store = Store(folder.parents[2])
        rows = read_table(folder / "images.parquet", IMAGES, ["camera", "uri", "byte_length"]).to_pylist()
        found = [(row["uri"], row["byte_length"]) for row in rows if row["camera"] == rig.reference_camera]
        if found:
            chosen = sorted({round(index) for index in np.linspace(0, len(found) - 1, _IMAGES)})
            labels[number] = classify_weather(plugin, [_decode(store, *found[index]) for index in chosen])
    return labels


def _decode(store: Store, uri: str, byte_length: int) -> UInt8:
    try:
        data = store.read_range(uri, 0, byte_length)
    except OSError as error:
        raise _broken(store, uri, f"cannot be read: {error}") from error
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB) if is_decodable(data) else None
    if image is None:
        raise _broken(store, uri, "cannot be decoded")
    return np.asarray(image, np.uint8)


def _broken(store: Store, uri: str, problem: str) -> RecordingError:
    return RecordingError(problem, file=store.full_path(uri), expected="a JPEG or PNG", remedy="restore the image")
