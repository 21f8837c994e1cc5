"""Pictures, one after the other, as a video file."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

from mirror.arrays import UInt8
from mirror.errors import UsageError
from mirror.installation import install_command


def write_video(path: Path, pictures: Iterable[UInt8], hz: float, quality: int = 20) -> int:
    """Write an H.264 video; pictures of an odd size lose their last row or column.

    Args:
        path: of the file, ``.mp4`` or ``.mkv``; complete or absent.
        pictures: (H, W, 3) RGB, all of one size.
        hz: pictures a second.
        quality: constant rate factor: less is better, 18 hardly to be told from the pictures.

    Returns:
        How many pictures.

    Raises:
        UsageError: PyAV is not installed, there is no picture, or one has another size.
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
            for picture in pictures:
                height, width = (size // 2 * 2 for size in picture.shape[:2])
                if not count:
                    stream.width, stream.height = width, height
                if (stream.width, stream.height) != (width, height):
                    raise UsageError(
                        f"a picture of {width} x {height} px", file=path, place=f"picture {count}",
                        expected=f"{stream.width} x {stream.height} px, as the first",
                    )  # fmt: skip
                frame = av.VideoFrame.from_ndarray(picture[:height, :width], format="rgb24")
                container.mux(stream.encode(frame))
                count += 1
            if not count:
                raise UsageError("no picture to make a video of", file=path)
            container.mux(stream.encode())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    return count
