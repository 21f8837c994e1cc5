"""What propagation knows of a traversal's geometry: poses, calibrations and boxes, where they exist."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.errors import DatasetError, UsageError
from mirror.geometry.box_projection import project_boxes
from mirror.privacy.detection import ImageKey
from mirror.privacy.options import Propagation
from mirror.privacy.propagation.cameras import PosedCamera, project_to_cameras
from mirror.privacy.propagation.tracks import follow_tracks
from mirror.privacy.propagation.vehicles import StripOptions, plate_strips
from mirror.privacy.regions import Region, merged

Regions = Mapping[ImageKey, Sequence[Region]]


def propagate(
    dataset: Dataset, traversal_id: str, detected: Regions, steps: Propagation, *, grow: float
) -> dict[ImageKey, list[Region]]:
    """Join the detectors' regions with regions from propagation, for the images of a traversal.

    Cameras and vehicles need poses, calibrations and boxes; where a traversal has none, these steps add nothing.

    Args:
        dataset: view of the dataset.
        traversal_id: the traversal.
        detected: regions of the detectors, of every image.
        steps: which steps run.
        grow: share by which regions will be enlarged.

    Returns:
        All regions by image; the origin of each tells which step added it.
    """
    regions = {key: merged(found) for key, found in detected.items()}
    added: dict[ImageKey, list[Region]] = {key: [] for key in detected}
    view = dataset.where(traversal=traversal_id)
    if steps.tracks:
        for key, more in _tracks(view, regions).items():
            added[key] += more
    if steps.cameras or steps.vehicles:
        for frame in view.frames():
            images = {name: image for name, image in frame.images.items() if (name, image.timestamp_ns) in regions}
            if steps.cameras:
                _add_cameras(images, regions, added)
            if steps.vehicles:
                _add_vehicles(frame, images, regions, added, steps.strips, grow)
    return {key: merged([*regions[key], *added[key]]) for key in regions}


def visible_objects(dataset: Dataset, traversal_id: str) -> dict[ImageKey, int]:
    """Count the visible boxes in each image of a traversal; images without geometry are left out."""
    counts: dict[ImageKey, int] = {}
    for frame in dataset.where(traversal=traversal_id).frames():
        for name, image in frame.images.items():
            try:
                boxes = frame.boxes(f"camera:{name}")
                visible = project_boxes(image.camera_model, boxes.pose, boxes.size_m).visible
            except (DatasetError, UsageError):
                continue
            counts[name, image.timestamp_ns] = int(visible.sum())
    return counts


def _tracks(view: Dataset, regions: Mapping[ImageKey, Sequence[Region]]) -> dict[ImageKey, list[Region]]:
    rows = view.table("images", ["camera", "timestamp_ns", "width_px", "height_px"]).to_pylist()
    sizes = {(row["camera"], row["timestamp_ns"]): (row["width_px"], row["height_px"]) for row in rows}
    added: dict[ImageKey, list[Region]] = {}
    for camera in sorted({camera for camera, _ in regions}):
        keys = sorted(key for key in regions if key[0] == camera)
        found = follow_tracks([regions[key] for key in keys], [key[1] for key in keys], sizes[keys[0]])
        added.update(zip(keys, found))
    return added


def _add_cameras(
    images: Mapping[str, Image], regions: Mapping[ImageKey, Sequence[Region]], added: Mapping[ImageKey, list[Region]]
) -> None:
    views = {}
    for name, image in images.items():
        try:
            views[name] = PosedCamera(image.camera_model, image.world_SE3_camera)
        except DatasetError:
            # Without a calibration or pose there is no geometry; detection does not need it.
            continue
    own = {name: regions[name, image.timestamp_ns] for name, image in images.items()}
    for name, more in project_to_cameras(own, views).items():
        added[name, images[name].timestamp_ns] += more


def _add_vehicles(
    frame: Frame,
    images: Mapping[str, Image],
    regions: Mapping[ImageKey, Sequence[Region]],
    added: Mapping[ImageKey, list[Region]],
    options: StripOptions,
    grow: float,
) -> None:
    for name, image in images.items():
        try:
            boxes = frame.boxes(f"camera:{name}")
            camera = image.camera_model
        except (DatasetError, UsageError):
            continue
        key = (name, image.timestamp_ns)
        strips = plate_strips(camera, boxes.pose, boxes.size_m, boxes.category, regions[key], options, grow=grow)
        added[key] += strips
