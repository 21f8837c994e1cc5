"""Files of lenses in YAML: OpenCV's, ROS's ``camera_info`` and Kalibr's ``camchain``.

These tools have the centre of the first pixel at 0, MIRROR at 0.5: half a pixel is added on reading, subtracted on
writing. OpenCV's parser reads all of them, which builds no objects.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.errors import RecordingError, UsageError
from mirror.geometry.cameras import COEFFICIENTS, Camera
from mirror.recordings.opening import read_file
from mirror.schema.files import write_bytes

_MODELS: Final = {
    "brown_conrady": "brown_conrady",
    "radtan": "brown_conrady",
    "plumb_bob": "brown_conrady",
    "rational": "rational",
    "rational_polynomial": "rational",
    "kannala_brandt": "kannala_brandt",
    "equidistant": "kannala_brandt",
    "fisheye": "kannala_brandt",
    "pinhole": "pinhole",
    "none": "pinhole",
}
_HEADER: Final = "%YAML:1.0\n---\n"
_EXPECTED: Final = (
    "a YAML file with image_width, image_height, camera_matrix and distortion_coefficients (OpenCV, ROS), or with"
    " cam0: camera_model, intrinsics, distortion_model, distortion_coeffs and resolution (Kalibr)"
)


def read_lens(file: Path, name: str | None = None) -> Camera:
    """Read the lens of one camera.

    Args:
        file: the YAML file.
        name: the camera in a file of Kalibr, such as ``cam1``; None: the only one.

    Raises:
        RecordingError: the file is no such file, has several cameras and none is named, or makes no lens; all that is
            missing is named.
    """
    storage = _parse(file)
    # Nodes are valid while their storage lives.
    root = storage.root()
    keys = [key for key in root.keys() if key.startswith("cam") and key[3:].isdigit()]  # noqa: SIM118
    if not keys and name is not None:
        raise _error(file, f"there is no camera {name!r}: the file holds one lens", "take the name of the camera out")
    if not keys:
        return _make(file, _opencv_values(file, root))
    if name is None and len(keys) == 1:
        name = keys[0]
    if name is None or name not in keys:
        problem = f"there is no camera {name!r}" if name else f"{len(keys)} cameras"
        raise _error(file, problem, f"name one of {', '.join(keys)} behind the file: {file.name}:{keys[0]}")
    return _make(file, _kalibr_values(file, root.getNode(name), name))


def write_lens(file: Path, camera: Camera, notes: Mapping[str, float | str] | None = None) -> None:
    """Write a lens as OpenCV's YAML.

    Args:
        file: the file to write.
        camera: a lens with a model of OpenCV.
        notes: further keys, such as the error of the calibration.

    Raises:
        UsageError: OpenCV has no such model.
    """
    import cv2

    if camera.model == "f_theta":
        raise UsageError("OpenCV has no f_theta lens", file=file, expected="another model")
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML)
    storage.write("image_width", camera.width_px)
    storage.write("image_height", camera.height_px)
    storage.write("distortion_model", camera.model)
    matrix = np.array(
        [[camera.fx_px, 0.0, camera.cx_px - 0.5], [0.0, camera.fy_px, camera.cy_px - 0.5], [0.0, 0.0, 1.0]]
    )
    storage.write("camera_matrix", matrix)
    storage.write("distortion_coefficients", np.array([camera.distortion or (0.0,) * 5]))
    for key, value in (notes or {}).items():
        storage.write(key, value)
    write_bytes(file, str(storage.releaseAndGetString()).encode())


def _parse(file: Path) -> Any:
    import cv2

    try:
        text = read_file(file).decode()
    except UnicodeDecodeError as error:
        raise _error(file, "the file is not text", "name another file") from error
    # OpenCV's parser needs its header, and items of a list farther in than their key, which Kalibr does not write.
    body = text if text.startswith("%YAML") else _HEADER + re.sub(r"(?m)^( *)- ", r"\1  - ", text)
    try:
        storage = cv2.FileStorage(body, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        usable = not root.empty() and root.isMap()
    except (cv2.error, SystemError) as error:
        raise _error(file, "the file is not YAML", "correct it, or name another file") from error
    if not usable:
        raise _error(file, "the file has no keys", "name another file")
    return storage


def _numbers(node: Any) -> list[float] | None:
    """The numbers of a matrix or a list, in any of the notations; None: there are none."""
    if node.isMap() and not node.getNode("data").empty():
        node = node.getNode("data")
    if not node.isSeq():
        return None
    values: list[float] = []
    for index in range(node.size()):
        item = node.at(index)
        if item.isSeq():
            values += _numbers(item) or []
        elif item.isReal() or item.isInt():
            values.append(float(item.real()))
        else:
            return None
    return values


def _opencv_values(file: Path, root: Any) -> dict[str, Any]:
    names = {
        "image_width": ("image_width", "width"),
        "image_height": ("image_height", "height"),
        "camera_matrix": ("camera_matrix", "cameraMatrix", "K", "intrinsic_matrix"),
        "distortion_coefficients": ("distortion_coefficients", "distCoeffs", "D", "dist_coeffs"),
    }
    nodes = {
        key: next((root.getNode(one) for one in usual if not root.getNode(one).empty()), None)
        for key, usual in names.items()
    }
    missing = [key for key, node in nodes.items() if node is None]
    matrix, coefficients = (
        None if nodes[key] is None else _numbers(nodes[key]) for key in ("camera_matrix", "distortion_coefficients")
    )
    if not missing and (matrix is None or len(matrix) != 9):
        missing.append("nine numbers of camera_matrix")
    if missing or matrix is None:
        raise _error(file, f"the file lacks {', '.join(missing)}", "add the keys")
    model = root.getNode("distortion_model").string()
    if not root.getNode("fisheye_model").empty() and root.getNode("fisheye_model").real():
        model = "kannala_brandt"
    return {
        "size": tuple(int(node.real()) for node in (nodes["image_width"], nodes["image_height"]) if node is not None),
        "intrinsics": (matrix[0], matrix[4], matrix[2], matrix[5]),
        "skew": matrix[1],
        "model": model,
        "coefficients": coefficients or [],
    }


def _kalibr_values(file: Path, node: Any, name: str) -> dict[str, Any]:
    keys = ("intrinsics", "distortion_coeffs", "resolution")
    numbers = {key: _numbers(node.getNode(key)) for key in keys}
    missing = [f"{name}.{key}" for key, value in numbers.items() if value is None]
    model = node.getNode("camera_model").string()
    if model not in ("", "pinhole"):
        raise _error(file, f"{name} has the camera model {model!r}", "calibrate with pinhole-radtan or pinhole-equi")
    intrinsics, coefficients, size = (numbers[key] or [] for key in keys)
    if not missing and (len(intrinsics) != 4 or len(size) != 2):
        missing.append(f"four numbers of {name}.intrinsics and two of {name}.resolution")
    if missing:
        raise _error(file, f"the file lacks {', '.join(missing)}", "add the keys")
    distortion = node.getNode("distortion_model").string()
    return {
        "size": tuple(map(int, size)),
        "intrinsics": tuple(intrinsics),
        "skew": 0.0,
        "model": "kannala_brandt" if distortion == "equidistant" else distortion,
        "coefficients": coefficients,
    }


def _make(file: Path, values: Mapping[str, Any]) -> Camera:
    """The lens of the values of a file, whatever tool wrote it."""
    coefficients = list(values["coefficients"])
    stated = values["model"]
    model = _MODELS.get(stated) if stated else ("rational" if len(coefficients) > 5 else "brown_conrady")
    if model is None:
        raise _error(file, f"the distortion model {stated!r} is unknown", f"one of {', '.join(_MODELS)}")
    if model == "brown_conrady" and len(coefficients) > 5 and any(coefficients[5:]):
        model = "rational"
    count = len(COEFFICIENTS[model].split())
    if any(coefficients[count:]) or values["skew"]:
        odd = "a skew" if values["skew"] else f"{len(coefficients)} coefficients"
        raise _error(file, f"{odd} of the model {model}", f"at most {count} coefficients, and no skew")
    if not any(coefficients) and model == "brown_conrady":
        model, count = "pinhole", 0
    fx, fy, cx, cy = values["intrinsics"]
    padded = tuple(np.array([*coefficients, *(0.0,) * count], np.float64)[:count].tolist())
    try:
        width, height = values["size"]
        return Camera(model, width, height, fx, fy, cx + 0.5, cy + 0.5, padded)
    except UsageError as error:
        raise RecordingError(error.problem, file=file, expected=error.expected, remedy="correct the numbers") from error


def _error(file: Path, problem: str, remedy: str) -> RecordingError:
    return RecordingError(problem, file=file, expected=_EXPECTED, remedy=remedy)
