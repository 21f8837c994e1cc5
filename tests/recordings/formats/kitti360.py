"""Writes drives as a KITTI-360 folder: poses, stamps, calibrations, images of two to four cameras, and boxes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import matrix_from_quaternion, quaternion_exp
from tests.recordings.formats.street import StreetDrive, StreetObject

CAMERAS = {"front_wide": "image_00", "front_narrow": "image_01"}
FISHEYES = {"rear_left": "image_02", "rear_right": "image_03"}
# The published lenses of the two fisheyes.
MEI = {
    "image_02": {
        "xi": 2.2134047507854890, "k1": 1.6798235660113681e-02, "k2": 1.6548773243373522, "p1": 4.2223943394772046e-04,
        "p2": 4.2462134260997584e-04, "gamma1": 1336.3220825849971, "gamma2": 1335.7883350012958,
        "u0": 716.94323510126321, "v0": 705.76498308221585,
    },
    "image_03": {
        "xi": 2.5535139132482758, "k1": 4.9370396274089505e-02, "k2": 4.5068455478645308, "p1": 1.3477698472982495e-03,
        "p2": -7.0340482615055284e-04, "gamma1": 1485.4388981875156, "gamma2": 1484.9477411748708,
        "u0": 698.88316784030962, "v0": 698.14541887723055,
    },
}  # fmt: skip
SEMANTIC_IDS = {"car": 13, "truck": 14, "person": 19, "pole": 21}
"""The dataset's numbers of classes, which its own scripts map to their names."""

_UNKNOWN_VEHICLE = 36
_GROUPS = {
    "mirror": ("xi",),
    "distortion": ("k1", "k2", "p1", "p2"),
    "projection": ("gamma1", "gamma2", "u0", "v0"),
}
# The sides of the cube by the numbers of its corners: two triangles each.
_SQUARES = ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 4, 5), (2, 3, 6, 7), (0, 2, 4, 6), (1, 3, 5, 7))
# The IMU's axes, y right and z down, in the ego's.
_EGO_FROM_IMU = np.diag([1.0, -1.0, -1.0, 1.0])
# What rectification turns a camera by.
TURN = quaternion_exp([[0.01, -0.02, 0.005]])


def write_kitti360(
    root: Path, drives: Sequence[StreetDrive], *, parked: Sequence[StreetObject] = (), boxes: bool = False
) -> Path:
    """Write the drives, and return the folder. The world is the dataset's; an image's frame is its index.

    Poses are those at the stamps of the first camera, which are also those of the other cameras.

    Args:
        root: the folder.
        drives: cameras of `CAMERAS`, and fisheyes of `FISHEYES`; their boxes are at stamps of frames.
        parked: objects that do not move, with one pose each.
        boxes: write the boxes.
    """
    (root / "calibration").mkdir(parents=True)
    for drive in drives:
        names = [name for name in CAMERAS if name in drive.cameras]
        stamps = drive.image_ns[names[0]]
        poses = root / "data_poses" / drive.name
        poses.mkdir(parents=True)
        matrix = _matrices(drive.poses_at(stamps)) @ _EGO_FROM_IMU
        rows = [f"{frame} {' '.join(f'{v:.12g}' for v in values[:3].ravel())}" for frame, values in enumerate(matrix)]
        (poses / "poses.txt").write_text("\n".join(rows) + "\n")
        for name in names:
            folder = root / "data_2d_raw" / drive.name / CAMERAS[name]
            (folder / "data_rect").mkdir(parents=True)
            text = [str(stamp.astype("datetime64[ns]")).replace("T", " ") for stamp in stamps]
            (folder / "timestamps.txt").write_text("\n".join(text) + "\n")
            for index in range(len(stamps)):
                (folder / "data_rect" / f"{index:010d}.png").write_bytes(drive.image(name, index, ".png"))
        for name in (name for name in FISHEYES if name in drive.cameras):
            folder = root / "data_2d_raw" / drive.name / FISHEYES[name]
            (folder / "data_rgb").mkdir(parents=True)
            (folder / "timestamps.txt").write_text("\n".join(text) + "\n")
            for index in range(len(stamps)):
                (folder / "data_rgb" / f"{index:010d}.png").write_bytes(drive.image(name, index, ".png"))
        if boxes:
            _write_boxes(root / "data_3d_bboxes" / "train" / f"{drive.name}.xml", drive, stamps, parked)
    names = [name for name in CAMERAS if name in drives[0].cameras]
    lenses, mountings = [], []
    turn = matrix_from_quaternion(TURN)[0]
    for name in names:
        lens, digits = drives[0].cameras[name], CAMERAS[name][-2:]
        unrectified = np.eye(4)
        unrectified[:3, :3] = turn
        imu_from_camera = _EGO_FROM_IMU @ _matrices(drives[0].ego_SE3_camera[name])[0] @ unrectified
        mountings.append(f"{CAMERAS[name]}: {_join(imu_from_camera[:3])}")
        projection = np.zeros((3, 4))
        projection[:, :3] = lens.intrinsic_matrix(first_pixel_centre=0.0)
        projection[0, 3] = -328.0 if digits == "01" else 0.0
        lenses += [
            f"S_rect_{digits}: {lens.width_px} {lens.height_px}",
            f"R_rect_{digits}: {_join(turn)}",
            f"P_rect_{digits}: {_join(projection)}",
        ]
    for name in (name for name in FISHEYES if name in drives[0].cameras):
        lens, fisheye = drives[0].cameras[name], FISHEYES[name]
        imu_from_camera = _EGO_FROM_IMU @ _matrices(drives[0].ego_SE3_camera[name])[0]
        mountings.append(f"{fisheye}: {_join(imu_from_camera[:3])}")
        text = ["%YAML:1.0", "---", "model_type: MEI", f"camera_name: {fisheye}"]
        text += [f"image_width: {lens.width_px}", f"image_height: {lens.height_px}"]
        for group, keys in _GROUPS.items():
            text += [f"{group}_parameters:", *(f"   {key}: {MEI[fisheye][key]:.17e}" for key in keys)]
        (root / "calibration" / f"{fisheye}.yaml").write_text("\n".join(text) + "\n")
    (root / "calibration" / "perspective.txt").write_text("calib_time: 2013\n" + "\n".join(lenses) + "\n")
    (root / "calibration" / "calib_cam_to_pose.txt").write_text("\n".join(mountings) + "\n")
    return root


def _write_boxes(file: Path, drive: StreetDrive, stamps: np.ndarray, parked: Sequence[StreetObject]) -> None:
    """An object at each frame of its boxes; a parked one once, for the window of all frames."""
    file.parent.mkdir(parents=True, exist_ok=True)
    rows = [
        (one, number, pose, int(np.searchsorted(stamps, stamp)))
        for number, one in enumerate(drive.objects)
        for pose, stamp in zip(_matrices(one.world_SE3_box), drive.box_ns)
    ]
    rows += [(one, 100 + number, _matrices(one.world_SE3_box)[0], -1) for number, one in enumerate(parked)]
    text = [
        '<?xml version="1.0"?>',
        "<opencv_storage>",
        "<object0><label>no box</label><timestamp>-1</timestamp></object0>",
    ]
    cube = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    faces = np.array([[a, b, c] for square in _SQUARES for a, b, c in (square[:3], square[1:])])
    for index, (one, instance, pose, frame) in enumerate(rows, 1):
        transform = pose @ np.diag([*one.size_m, 1.0])
        semantic = SEMANTIC_IDS.get(one.category, _UNKNOWN_VEHICLE)
        text += [
            f"<object{index}><index>{index}</index><label>{one.category}</label><timestamp>{frame}</timestamp>",
            f"<semanticId>{semantic}</semanticId><instanceId>{instance}</instanceId>",
            f"<start_frame>0</start_frame><end_frame>{len(stamps) - 1}</end_frame>",
            f"{_xml_matrix('transform', transform)}{_xml_matrix('vertices', cube)}"
            f"{_xml_matrix('faces', faces)}</object{index}>",
        ]
    file.write_text("\n".join([*text, "</opencv_storage>"]) + "\n")


def _xml_matrix(name: str, values: np.ndarray) -> str:
    rows, cols = values.shape
    return (
        f'<{name} type_id="opencv-matrix"><rows>{rows}</rows><cols>{cols}</cols><dt>f</dt>\n'
        f"<data>{_join(values)} </data></{name}>"
    )


def _join(values: np.ndarray) -> str:
    return " ".join(f"{value:.15g}" for value in values.ravel())


def _matrices(poses: Poses) -> np.ndarray:
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = matrix_from_quaternion(poses.rotation), poses.translation
    return out
