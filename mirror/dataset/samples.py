"""One frame as tensors: images with their lenses, poses, timestamps, masks, boxes and ids."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import itemgetter
from typing import Any, Final

import cv2
import numpy as np
import torch
from torch.utils.data import get_worker_info

from mirror.arrays import AnyArray, Float64, UInt8
from mirror.dataset.contents import SampleContents
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image, Mask, compose_camera_poses
from mirror.dataset.images.decoding import run_jobs, split_planes
from mirror.dataset.raster import ImageRaster, image_raster
from mirror.errors import DatasetError, UsageError
from mirror.geometry.cameras import COEFFICIENTS, Camera

Sample = dict[str, Any]

LENS_MODELS: Final = tuple(COEFFICIENTS)
"""Camera models by their number in samples."""

_COEFFICIENTS: Final = 16


def make_sample(frame: Frame, contents: SampleContents, shape: tuple[int, int]) -> Sample:
    """Make the tensors of one frame, which torch can collate; `mirror.dataset.torch.FrameDataset` lists them.

    Args:
        frame: the frame.
        contents: the contents of samples.
        shape: height and width of the image tensors.

    Raises:
        UsageError: an image is larger than the shape, or an image has several masks of a kind and none was chosen.
        DatasetError: an image, mask, pose or calibration is missing or broken.
    """
    arrays = _empty_arrays(contents, shape)
    jobs, costs = [], []
    images = [(row, frame.images.get(camera)) for row, camera in enumerate(contents.cameras)]
    present = [(row, image) for row, image in images if image is not None and not image.is_withheld]
    # Together: a call for one pose costs as much as for seven.
    poses = compose_camera_poses([image for _, image in present]).matrix()
    for (row, image), pose in zip(present, poses):
        raster = _raster_of(image, contents)
        _write_geometry(arrays, row, image, raster.final, pose)
        jobs.append(partial(_write_pixels, image, raster, contents, _map_arrays(arrays, itemgetter((row, ...)))))
        costs.append(image.byte_length)
    in_worker = get_worker_info() is not None
    if in_worker and cv2.getNumThreads() != 1:
        # One of several workers must not start threads of its own.
        cv2.setNumThreads(1)
    run_jobs(jobs, costs, 1 if in_worker else None)
    if contents.is_single_camera:
        arrays = _map_arrays(arrays, itemgetter((0, ...)))
    if contents.boxes is not None:
        arrays |= _boxes(frame, contents, contents.boxes)
    return {
        **_map_arrays(arrays, torch.from_numpy),
        "world_SE3_ego": torch.from_numpy(frame.world_SE3_ego.matrix()[0]),
        "scene_id": frame.scene_id,
        "traversal_id": frame.traversal_id,
        "frame_index": frame.frame_index,
        "frame_timestamp_ns": frame.timestamp_ns,
    }


def camera_of(sample: Mapping[str, Any], *index: int) -> Camera:
    """Return the lens of one image of a sample or batch, for `mirror.geometry`.

    Args:
        sample: a sample, or a batch of collated samples.
        index: number of the camera in a sample; numbers of sample and camera in a batch. If samples have a single
            camera, its number is left out.

    Raises:
        UsageError: the index is out of range, or the camera has no image in that frame.
    """
    lens = sample["lens"]
    if len(index) != lens.ndim or not all(0 <= axis < size for axis, size in zip(index, lens.shape)):
        raise UsageError(f"image {index} of lenses of shape {tuple(lens.shape)}", expected="an index for each axis")
    if not sample["valid"][index]:
        raise UsageError(
            f"image {index} is missing: its camera has none here, or it is withheld", remedy="skip it by 'valid'"
        )
    model, matrix = LENS_MODELS[int(lens[index])], sample["intrinsics"][index].tolist()
    count = int(sample["distortion_count"][index])
    return Camera(
        model,
        int(sample["width_px"][index]),
        int(sample["height_px"][index]),
        fx_px=matrix[0][0],
        fy_px=matrix[1][1],
        cx_px=matrix[0][2],
        cy_px=matrix[1][2],
        distortion=tuple(sample["distortion"][index][:count].tolist()),
    )


def _map_arrays(arrays: Mapping[str, Any], change: Callable[[AnyArray], Any]) -> dict[str, Any]:
    """Apply a function to every array of nested dictionaries."""
    return {
        name: _map_arrays(item, change) if isinstance(item, dict) else change(item) for name, item in arrays.items()
    }


def _empty_arrays(contents: SampleContents, shape: tuple[int, int]) -> dict[str, Any]:
    """Arrays of a sample without images; the first axis is the camera."""
    count = len(contents.cameras)
    channels = (3, *shape) if contents.layout == "chw" else (*shape, 3)
    arrays: dict[str, Any] = {
        "images": np.zeros((count, *channels), np.uint8),
        "valid": np.zeros(count, np.bool_),
        "pixel_valid": np.zeros((count, *shape), np.bool_),
        "lens": np.full(count, -1, np.int64),
        "intrinsics": np.zeros((count, 3, 3)),
        "distortion": np.zeros((count, _COEFFICIENTS)),
        "world_SE3_camera": np.zeros((count, 4, 4)),
    }
    stamps = ("timestamp_ns", "exposure_start_ns", "exposure_end_ns")
    for name in (*stamps, "height_px", "width_px", "distortion_count"):
        arrays[name] = np.zeros(count, np.int64)
    kinds = {name: np.uint8 if _is_instance(name) else np.bool_ for name in contents.masks}
    arrays["masks"] = {name: np.zeros((count, *shape), kind) for name, kind in kinds.items()}
    arrays["mask_valid"] = {name: np.zeros(count, np.bool_) for name in kinds}
    return arrays


def _raster_of(image: Image, contents: SampleContents) -> ImageRaster:
    camera = image.camera_model
    if (camera.width_px, camera.height_px) != (image.width_px, image.height_px):
        raise DatasetError(
            f"the image has {image.width_px} x {image.height_px} px, but its calibration is for {camera.width_px} x "
            f"{camera.height_px} px",
            place=f"camera {image.camera}, timestamp_ns {image.timestamp_ns}",
            expected="a calibration of the recorded raster",
            remedy="correct the calibration, or choose another with with_layers(calibrations=..., stage=...)",
        )
    if len(camera.distortion) > _COEFFICIENTS:
        raise UsageError(
            f"a lens of {len(camera.distortion)} coefficients",
            place=f"camera {image.camera}",
            expected=f"at most {_COEFFICIENTS}",
            remedy="undistort=True",
        )
    return image_raster(camera, contents.undistort, contents.resize)


def _write_geometry(arrays: Mapping[str, Any], row: int, image: Image, camera: Camera, pose: Float64) -> None:
    """Write the values of an image that are known before it is decoded."""
    values = {
        "valid": True,
        "timestamp_ns": image.timestamp_ns,
        "exposure_start_ns": image.exposure_start_ns,
        "exposure_end_ns": image.exposure_end_ns,
        "height_px": camera.height_px,
        "width_px": camera.width_px,
        "lens": LENS_MODELS.index(camera.model),
        "intrinsics": camera.intrinsic_matrix(),
        "distortion_count": len(camera.distortion),
        "world_SE3_camera": pose,
    }
    for name, value in values.items():
        arrays[name][row] = value
    arrays["distortion"][row, : len(camera.distortion)] = camera.distortion


def _write_pixels(image: Image, raster: ImageRaster, contents: SampleContents, out: Mapping[str, Any]) -> None:
    """Write the pixels and masks of one image into arrays without a camera axis."""
    height, width = raster.final.height_px, raster.final.width_px
    if height > out["pixel_valid"].shape[0] or width > out["pixel_valid"].shape[1]:
        raise UsageError(
            f"camera {image.camera} has {width} x {height} px", expected=f"at most {out['pixel_valid'].shape[::-1]}"
        )
    pixels = raster.image(image.decode(verify=contents.verify))
    if contents.layout == "chw":
        split_planes(pixels, out["images"][:, :height, :width])
    else:
        out["images"][:height, :width] = pixels
    out["pixel_valid"][:height, :width] = raster.covered
    recorded = image.masks() if contents.masks else []
    for name in contents.masks:
        mask = _mask(image, recorded, name)
        if mask is not None:
            if mask.shape != (image.height_px, image.width_px):
                raise DatasetError(
                    f"the {name} mask has {mask.shape[1]} x {mask.shape[0]} px",
                    place=f"camera {image.camera}, timestamp_ns {image.timestamp_ns}",
                    expected=f"{image.width_px} x {image.height_px} px, as its image",
                    remedy="correct the mask, or leave it out with masks=[...]",
                )
            values = raster.mask(mask)
            out["masks"][name][:height, :width] = values if _is_instance(name) else values > 0
            out["mask_valid"][name][...] = True


def _mask(image: Image, recorded: Sequence[Mask], name: str) -> UInt8 | None:
    """The recorded mask (H, W) of an image for a name of `SampleContents.masks`; None: the image has none."""
    kind, _, layer = name.partition("/")
    found = {f"{mask.source}@{mask.source_version}": mask for mask in recorded if mask.kind == kind}
    if layer:
        return found[layer].decode() if layer in found else None
    if len(found) > 1:
        raise UsageError(
            f"camera {image.camera} has {kind} masks of {', '.join(found)}",
            remedy=f"choose: masks=[{f'{kind}/{next(iter(found))}'!r}]",
        )
    for mask in found.values():
        return mask.decode()
    return image.static_mask() if kind == "ego" else None


def _boxes(frame: Frame, contents: SampleContents, count: int) -> dict[str, AnyArray]:
    boxes = frame.boxes("world")
    numbers = {category: number for number, category in enumerate(contents.categories)}
    rows = [row for row, category in enumerate(boxes.category) if category in numbers]
    arrays: dict[str, AnyArray] = {
        "box_valid": np.zeros(count, np.bool_),
        "world_SE3_box": np.zeros((count, 4, 4)),
        "box_size_m": np.zeros((count, 3)),
        "box_velocity_mps": np.full((count, 3), np.nan),
        "box_category": np.full(count, -1, np.int64),
        "box_track": np.full(count, -1, np.int64),
        "box_score": np.full(count, np.nan),
        "box_timestamp_ns": np.array(boxes.timestamp_ns),
    }
    if rows:
        filled = slice(len(rows))
        arrays["box_valid"][filled] = True
        arrays["world_SE3_box"][filled] = boxes.pose.matrix()[rows]
        arrays["box_size_m"][filled] = boxes.size_m[rows]
        arrays["box_velocity_mps"][filled] = boxes.velocity_mps[rows]
        arrays["box_category"][filled] = [numbers[boxes.category[row]] for row in rows]
        arrays["box_track"][filled] = [bisect_left(frame.track_ids, boxes.track_id[row]) for row in rows]
        arrays["box_score"][filled] = boxes.score[rows]
    return arrays


def _is_instance(name: str) -> bool:
    return name.partition("/")[0] == "instance"
