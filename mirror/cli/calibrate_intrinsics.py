"""``mirror calibrate intrinsics FOLDER``."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mirror.arrays import UInt8
    from mirror.calibration.intrinsics import Intrinsics

_COMMAND = "mirror calibrate intrinsics"
_EXAMPLES = (
    "mirror calibrate intrinsics boards --board 9x6 --out lens.yaml",
    "mirror calibrate intrinsics boards --board 9x6 --out lens.yaml --recording drive --camera front_wide",
)
_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff")


@dataclass(frozen=True)
class Arguments:
    """Estimate the lens of a camera from images of a chessboard or a ChArUco board.

    Writes the lens as OpenCV's YAML, and into the calibrations of a recording if one is named. Use 10 to 30 sharp
    images in which the board is tilted about both axes and reaches the corners of the image. Exit codes: 0 done, 1 done
    with doubts about the lens, which are named, 2 no lens was found.
    """

    images: Annotated[tyro.conf.Positional[Path], help_text(metavar="FOLDER")]
    """Folder of the images of one camera."""
    board: Annotated[str, help_text(metavar="COLUMNSxROWS")]
    """Inner corners of the board along each side, one less than its squares, such as 9x6."""
    out: Annotated[Path, help_text(metavar="FILE")]
    """YAML file of the lens."""
    kind: Annotated[Literal["chessboard", "charuco"], help_text(metavar="KIND")] = "chessboard"
    """Kind of the board: chessboard or charuco."""
    dictionary: Annotated[str, help_text(metavar="NAME")] = "DICT_5X5_100"
    """Markers of a ChArUco board, by OpenCV's name."""
    marker: float = 0.75
    """Side of a marker of a ChArUco board, as a part of the side of a square."""
    model: Annotated[Literal["brown_conrady", "rational", "kannala_brandt"], help_text(metavar="MODEL")] = (
        "brown_conrady"
    )
    """Lens: brown_conrady, rational (wide angles) or kannala_brandt (fisheye)."""
    recording: Annotated[Path | None, help_text(default="none", metavar="RECORDING")] = None
    """Recording in the folder layout, whose factory calibration of --camera gets the lens."""
    camera: Annotated[str | None, help_text(default="none", metavar="NAME")] = None
    """Camera of the recording."""
    mounting: Annotated[str | None, help_text(default="that of the recording", metavar="X,Y,Z,ROLL,PITCH,YAW")] = None
    """Mounting of the camera: metres, and degrees about x forward, y left and z up; 0,0,0 looks forward."""
    json: bool = False
    """Print the result as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the subcommand."""
    arguments = parse_arguments(Arguments, argv, _COMMAND, examples=_EXAMPLES)

    from mirror.calibration.boards import CalibrationBoard
    from mirror.calibration.intrinsics import calibrate_intrinsics
    from mirror.recordings.folder_lens import put_lens, require_lens_place
    from mirror.recordings.lens_files import write_lens
    from mirror.recordings.mounting import parse_mounting
    from mirror.schema.folders import require_output_file

    board = CalibrationBoard(*_parse_size(arguments.board), arguments.kind, arguments.dictionary, arguments.marker)
    require_output_file(arguments.out)
    mounting = None if arguments.mounting is None else parse_mounting(arguments.mounting, "--mounting")
    if (arguments.recording is None) != (arguments.camera is None):
        raise UsageError(
            "a recording and its camera belong together", place="--recording, --camera", expected="both or none",
            remedy="add the other option",
        )  # fmt: skip
    if arguments.recording is not None and arguments.camera is not None:
        require_lens_place(arguments.recording, arguments.camera, mounting)
    found = calibrate_intrinsics(_read_images(arguments.images), board, arguments.model)
    sigma = {f"sigma_{name}": value for name, value in found.sigma.items()}
    write_lens(arguments.out, found.camera, {"avg_reprojection_error": found.rms_px, **sigma})
    if arguments.recording is not None and arguments.camera is not None:
        method = f"{arguments.kind}, {len(found.image_rms_px)} images, rms {found.rms_px:.2f} px"
        put_lens(arguments.recording, arguments.camera, found.camera, mounting, method)
    if arguments.json:
        print(json.dumps({**found.to_dict(), "out": str(arguments.out)}))
    else:
        _print(found, arguments)
    return ExitCode.FINDINGS if found.doubts() else ExitCode.DONE


def _parse_size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,3})x(\d{1,3})", text)
    if match is None:
        raise UsageError(f"{text!r} is no size of a board", place="--board", expected="COLUMNSxROWS, such as 9x6")
    return int(match[1]), int(match[2])


def _read_images(folder: Path) -> Iterator[tuple[str, UInt8]]:
    """The grey images of a folder by name; files that are no images are left out with a note."""
    import sys

    import cv2
    import numpy as np

    if not folder.is_dir():
        raise UsageError("there is no folder at this path", file=folder, expected="a folder of images of the board")
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES)
    if not files:
        raise UsageError(
            "the folder has no images", file=folder, expected=f"images of the board ({', '.join(_SUFFIXES)})",
            remedy="name the folder that holds the images itself",
        )  # fmt: skip
    for file in files:
        # The raster as the camera wrote it: a lens does not turn with an EXIF orientation.
        data = np.frombuffer(file.read_bytes(), np.uint8)
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(data, flags) if len(data) else None
        if image is None:
            print(f"{file}: not an image, left out", file=sys.stderr)
            continue
        yield file.name, np.asarray(image, np.uint8)


def _print(found: Intrinsics, arguments: Arguments) -> None:
    from mirror.cli.output import plain_console

    console = plain_console(soft_wrap=True)
    for name, rms in found.image_rms_px.items():
        console.print(f"  {name}: rms {rms:.2f} px")
    for name, reason in found.rejected.items():
        console.print(f"  {name}: not used: {reason}")
    camera, sigma = found.camera, found.sigma
    values = dict(zip(("fx_px", "fy_px", "cx_px", "cy_px"), (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)))
    values |= dict(zip(found.parameters[4:], camera.distortion))
    console.print(f"{camera.model}, {camera.width_px} x {camera.height_px} px, rms {found.rms_px:.3f} px")
    for name, value in values.items():
        digits = 2 if name.endswith("_px") else 5
        console.print(f"  {name:<6} {value:>12.{digits}f} +- {sigma[name]:.{digits}f}")
    console.print(
        f"corners cover {found.covered:.0%} of the image and reach {found.reach:.0%} of the way to its corners; boards"
        f" differ by up to {found.spread_deg:.0f} degrees"
    )
    for doubt in found.doubts():
        console.print(f"doubt: {doubt}")
    console.print(f"lens: {arguments.out} (OpenCV: the centre of the first pixel is at 0)")
    if arguments.recording is not None:
        file = arguments.recording / "calibrations" / "factory.json"
        console.print(f"calibration: {file}, camera {arguments.camera}")
