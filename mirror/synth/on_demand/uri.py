"""How an image on demand is named: ``mirror-synth://<street>/<preset>/<seed>/<drive>/<camera>/<true_ns>.png``."""

from __future__ import annotations

from typing import Final, NamedTuple

from mirror.errors import DatasetError

SCHEME: Final = "mirror-synth"
STREET: Final = 1
"""Version of the street: another draws other images by the same names."""
_EXPECTED: Final = f"{SCHEME}://{STREET}/<preset>/<seed>/<drive>/<camera>/<true_ns>.png"


class ImageName(NamedTuple):
    """Which image.

    Attributes:
        preset: its recording's preset.
        seed: of that.
        drive_id: the drive.
        camera: the camera.
        true_ns: when it truly was taken: mid-exposure.
    """

    preset: str
    seed: int
    drive_id: str
    camera: str
    true_ns: int

    def uri(self) -> str:
        """Its uri."""
        return f"{SCHEME}://{STREET}/{self.preset}/{self.seed}/{self.drive_id}/{self.camera}/{self.true_ns}.png"


def parse_image_name(path: str) -> ImageName:
    """The image that a uri, or one without its scheme, names.

    Raises:
        DatasetError: it names none, or one of another version of the street.
    """
    parts = path.removeprefix(f"{SCHEME}://").split("/")
    if parts[0].isdecimal() and int(parts[0]) != STREET:
        raise DatasetError(
            f"the image is of version {parts[0]} of the synthetic street, which is not drawn any more",
            file=f"{SCHEME}://{'/'.join(parts)}",
            expected=f"version {STREET}",
            remedy="install the version of the toolkit that wrote the recordings, or write and ingest them anew",
        )
    if len(parts) != 6 or not (parts[2].isdecimal() and parts[5].removesuffix(".png").isdecimal()):
        raise DatasetError("no image's name", file=f"{SCHEME}://{'/'.join(parts)}", expected=_EXPECTED)
    return ImageName(parts[1], int(parts[2]), parts[3], parts[4], int(parts[5].removesuffix(".png")))
