"""Writes a PLY of 3D Gaussian Splatting as SPZ, which web viewers open: a tenth of the size, by the package gsply."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from mirror.errors import DatasetError, UsageError
from mirror.installation import install_command
from mirror.schema.files import write_bytes

_LARGEST_FRACTION: Final = 12
_BITS: Final = 23


@dataclass(frozen=True)
class SpzFile:
    """Figures of a written file.

    Attributes:
        gaussians: number of Gaussians.
        bytes: size of the file.
        step_m: positions are multiples of this.
    """

    gaussians: int
    bytes: int
    step_m: float


def require_gsply() -> None:
    """Require the package that writes SPZ.

    Raises:
        UsageError: gsply is not installed.
    """
    try:
        import gsply  # noqa: F401
    except ModuleNotFoundError as error:
        raise UsageError("SPZ needs gsply", place="--out", remedy=install_command("spz")) from error


def write_spz(ply: Path, out: Path) -> SpzFile:
    """Write a PLY as SPZ (version 3), in the same coordinates; the file is read back before it gets its name.

    Positions have steps of at most 2 mm, colours and opacities 8 bits.

    Args:
        ply: the PLY.
        out: file to write.

    Raises:
        UsageError: gsply is not installed, or a Gaussian is too far away for 24 bits.
        DatasetError: the file cannot be written, or does not read back.
    """
    require_gsply()
    import gsply

    gaussians = gsply.plyread(str(ply))
    largest = float(np.abs(gaussians.means).max(initial=0.0))
    fraction = min(_LARGEST_FRACTION, int(np.floor(np.log2((2**_BITS - 1) / max(largest, 1e-9)))))
    if fraction < 9:
        raise UsageError(
            f"a Gaussian is {largest:,.0f} m from the centre", place="--sky", expected="at most 16 km",
            remedy="pull the sky in, or clip it: --sky pull",
        )  # fmt: skip
    unfinished = out.with_name(f".{out.name}.part")
    try:
        gsply.write_spz(str(unfinished), gaussians, version=3, fractional_bits=fraction)
        back = gsply.read_spz(str(unfinished))
        step = 2.0**-fraction
        if len(back.means) != len(gaussians.means) or not np.abs(back.means - gaussians.means).max(initial=0.0) <= step:
            raise DatasetError("the file does not read back", file=out, expected="the positions of the PLY")
        write_bytes(out, unfinished.read_bytes())
    except OSError as error:
        raise DatasetError(f"cannot be written: {error}", file=out, place="--out") from error
    finally:
        unfinished.unlink(missing_ok=True)
    return SpzFile(len(back.means), out.stat().st_size, step)
