"""``driver.toml``: what a remote policy gets, and how long it may take."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

from pydantic import Field, ValidationError

from hybridworldsim.simulator.remote.lenses import Lens
from mirror.errors import SchemaError, UsageError
from mirror.schema.documents import Document
from mirror.schema.problems import describe_problem_and_value
from mirror.schema.strict_toml import TomlError, decode_toml

FRONT_WIDE: Final = "camera_front_wide_120fov"


class DriverFile(Document):
    """The inputs of a remote policy, and its time limit.

    Attributes:
        cameras: by name of a camera of the rig, its name on the wire; no other camera is rendered or sent.
        lens: "own": cameras are described by their own model; "f_theta": by an f-theta polynomial, which drivers that
            rectify images need.
        image_format: "jpeg" or "png".
        quality: quality of JPEG images.
        deadline_s: longest time for all calls of one step together.
        max_poses: greatest number of poses in an answer.
    """

    cameras: dict[str, str] = Field(default_factory=lambda: {"front_wide": FRONT_WIDE})
    lens: Lens = "own"
    image_format: Literal["jpeg", "png"] = "jpeg"
    quality: int = Field(default=95, ge=1, le=100)
    deadline_s: float = Field(default=30.0, gt=0, le=3600, allow_inf_nan=False)
    max_poses: int = Field(default=1000, ge=2, le=100_000)


def read_driver_file(path: Path) -> DriverFile:
    """Read a file.

    Raises:
        UsageError: the file cannot be read.
        SchemaError: the file is not TOML, or a key is unknown or wrong.
    """
    try:
        return DriverFile.model_validate(decode_toml(path.read_bytes()))
    except OSError as error:
        raise UsageError(f"cannot be read: {error.strerror}", file=path, expected="the TOML of a driver") from error
    except TomlError as error:
        raise SchemaError(f"not TOML ({error})", file=path, expected="the TOML of a driver") from error
    except ValidationError as error:
        first = error.errors()[0]
        raise SchemaError(
            describe_problem_and_value(first), file=path,
            place=".".join(str(part) for part in first["loc"]) or None,
            expected="a driver's file as docs/simulation/policies.md describes it",
        ) from error  # fmt: skip
