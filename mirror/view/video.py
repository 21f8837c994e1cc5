"""Writes a sequence of images as a video file."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

from mirror.arrays import UInt8
from mirror.errors import UsageError
from mirror.installation import install_command


def write_video(path: Path, images: Iterable[UInt8], hz: float, quality: int = 20) -> int:
    """Write an H.264 video; images of an odd size lose their last row or column.

    Args:
        path: the file, ``.mp4`` or ``.mkv``; after an error it does not exist.
        images: (H, W, 3) RGB, all of one size.
        hz: images per second.
        quality: constant rate factor: lower is better; at 18 the loss is hardly visible.

    Returns:
        The number of images.

    Raises:
        UsageError: PyAV is not installed, there is no image, or the images have several sizes.
    """
    try:
        import av
    except ImportError as error:
        raise UsageError("videos need PyAV", remedy=install_command("video")) from error
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.part{path.suffix}")
    count = 0
    try:
        with av.open(str(temporary), "w") as container:
            stream = container.add_stream("libx264", rate=Fraction(hz).limit_denominator(1001))
            stream.pix_fmt = "yuv420p"
            stream.options = {"crf": str(quality)}
            for image in images:
                height, width = (size // 2 * 2 for size in image.shape[:2])
                if not count:
                    stream.width, stream.height = width, height
                if (stream.width, stream.height) != (width, height):
                    raise UsageError(
                        f"an image of {width} x {height} px", file=path, place=f"image {count}",
                        expected=f"{stream.width} x {stream.height} px, as the first",
                    )  # fmt: skip
                frame = av.VideoFrame.from_ndarray(image[:height, :width], format="rgb24")
                container.mux(stream.encode(frame))
                count += 1
            if not count:
                raise UsageError("there are no images", file=path)
            container.mux(stream.encode())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    return count
