"""Verified weights, and ONNX sessions with one thread."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mirror.errors import MirrorError
from mirror.installation import install_command
from mirror.weights.errors import WeightsUnavailableError
from mirror.weights.resolve import ResolvedWeights, WeightResolver, file_sha256


class DetectorError(MirrorError):
    """A detector cannot be made, or it failed on an image."""


def resolve_weights(name: str, path: Path | None) -> ResolvedWeights:
    """Find the weights of a built-in detector and verify their hash.

    Raises:
        WeightsUnavailableError: they are missing, or not the published ones.
    """
    return WeightResolver({} if path is None else {name: path}).resolve(name)


def hash_weights(name: str, path: Path | None) -> tuple[Path, str]:
    """Return the file and hash of weights that the user supplies.

    Raises:
        WeightsUnavailableError: no file is named, or there is none.
    """
    if path is None or not path.is_file():
        raise WeightsUnavailableError(
            "no file of weights was named" if path is None else "no such file",
            file=path,
            place=f"detector {name}",
            expected="a file of weights, as no package contains them",
            remedy=f"name it: --detector {name}=FILE",
        )
    return path, file_sha256(path)


def open_session(data: bytes, file: Path) -> Any:
    """Return an ONNX session on the CPU with one thread: images are spread over processes.

    Raises:
        DetectorError: onnxruntime is not installed, or it cannot read the model.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise DetectorError("onnxruntime is not installed", file=file, remedy=install_command("privacy")) from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        problem = f"the model cannot be read: {error}".splitlines()[0]
        raise DetectorError(problem, file=file, expected="an ONNX model") from error
