"""The URI of an image on demand: ``mirror-synth://<street>/<preset>/<seed>/<drive>/<camera>/<true_ns>.png``."""

from __future__ import annotations

from typing import Final, NamedTuple

from mirror.errors import DatasetError

SCHEME: Final = "mirror-synth"
STREET: Final = 1
"""Version of the synthetic street; another version renders other images for the same names."""
_EXPECTED: Final = f"{SCHEME}://{STREET}/<preset>/<seed>/<drive>/<camera>/<true_ns>.png"


class ImageName(NamedTuple):
    """The name of an image on demand.

    Attributes:
        preset: preset of the recording.
        seed: seed of the recording.
        drive_id: id of the drive.
        camera: name of the camera.
        true_ns: true mid-exposure time.
    """

    preset: str
    seed: int
    drive_id: str
    camera: str
    true_ns: int

    def uri(self) -> str:
        """Return the URI of the image."""
        return f"{SCHEME}://{STREET}/{self.preset}/{self.seed}/{self.drive_id}/{self.camera}/{self.true_ns}.png"


def parse_image_name(path: str) -> ImageName:
    """Parse the URI of an image on demand, with or without its scheme.

    Raises:
        DatasetError: the URI is malformed, or names an image of another version of the street.
    """
    parts = path.removeprefix(f"{SCHEME}://").split("/")
    if parts[0].isdecimal() and int(parts[0]) != STREET:
        raise DatasetError(
            f"the image is of version {parts[0]} of the synthetic street, which this toolkit does not render",
            file=f"{SCHEME}://{'/'.join(parts)}",
            expected=f"version {STREET}",
            remedy="install the version of the toolkit that wrote the recordings, or write and ingest them again",
        )
    numbers = (parts[2], parts[5].removesuffix(".png")) if len(parts) == 6 else ()
    if not numbers or not all(number.isdecimal() and number.isascii() and len(number) < 20 for number in numbers):
        raise DatasetError("not the URI of an image", file=f"{SCHEME}://{'/'.join(parts)}", expected=_EXPECTED)
    return ImageName(parts[1], int(numbers[0]), parts[3], parts[4], int(numbers[1]))
