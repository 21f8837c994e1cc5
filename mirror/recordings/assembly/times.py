"""When the images of a camera were taken: from a table, from their names, or from EXIF data."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.recordings.assembly.exif import read_exif_time
from mirror.recordings.opening import read_file_start
from mirror.recordings.stamps import parse_stamps
from mirror.recordings.tabular import RecordingRows, read_header, read_rows
from mirror.recordings.time import SECOND_NS

_HEADER_BYTES: Final = 1 << 17
_DIGITS: Final = {19: 1, 16: 1_000, 13: 1_000_000, 10: SECOND_NS}
"""Length of the unit in nanoseconds, by the number of digits of a Unix time of this century."""
_UNIX: Final = re.compile(r"(?:^|[^0-9])([0-9]{19}|[0-9]{16}|[0-9]{13}|[0-9]{10})(?:[._]([0-9]{1,9}))?$")
_DATE: Final = re.compile(
    r"(20[0-9]{2})[-_.]?([01][0-9])[-_.]?([0-3][0-9])[-_T. ]?([0-2][0-9])[-_.:h]?([0-5][0-9])[-_.:m]?([0-6][0-9])"
    r"(?:[-_.,s]?([0-9]{1,9}))?(Z)?$"
)
_EXPOSURES: Final = ("exposure_start_ns", "exposure_end_ns")


@dataclass(frozen=True, eq=False)
class ImageTimes:
    """Times of the images of a camera.

    Attributes:
        names: (N,) names of files, or numbers of a video's frames as text.
        start_ns: (N,) start of the exposure, Unix time.
        end_ns: (N,) end of the exposure, Unix time.
        source: where the times come from, in words.
    """

    names: tuple[str, ...]
    start_ns: Int64
    end_ns: Int64
    source: str


def image_times(folder: Path, names: list[str], tz: str | None) -> ImageTimes:
    """Return the times of images without a table of times, from their names or else from EXIF data.

    Args:
        folder: the folder of the images.
        names: names of the files.
        tz: IANA zone of times without an offset; None: they must state one.

    Raises:
        RecordingError: neither names nor EXIF data give each image a time of its own.
    """
    stamps = _from_names(folder, names, tz)
    if stamps is not None and len(np.unique(stamps)) == len(names):
        return ImageTimes(tuple(names), stamps, stamps, "names of the files")
    texts = [read_exif_time(read_file_start(folder / name, _HEADER_BYTES)[0]) for name in names]
    missing = [name for name, text in zip(names, texts) if text is None]
    if missing:
        what = "names that repeat a time" if stamps is not None else "names that are no times"
        raise RecordingError(
            f"{what}, and {len(missing)} of {len(names)} images have no time in EXIF data, such as {missing[0]}",
            file=folder,
            expected="names that end in a Unix time or in YYYYMMDD_HHMMSS[fraction], DateTimeOriginal, or a table",
            remedy="give a table with file,timestamp_ns: --times CAMERA=FILE.csv",
        )
    stamps = _parse(folder, "EXIF", [text or "" for text in texts], tz)
    if len(np.unique(stamps)) < len(names):
        raise RecordingError(
            f"{len(names) - len(np.unique(stamps))} images repeat the time of another: EXIF data has whole seconds",
            file=folder,
            expected="one time for each image",
            remedy="give a table with file,timestamp_ns: --times CAMERA=FILE.csv",
        )
    source = "EXIF data"
    if (stamps % SECOND_NS == 0).all():
        source += " (whole seconds: at 50 km/h an image is up to 14 m off)"
    return ImageTimes(tuple(names), stamps, stamps, source)


def table_times(table: Path, key: str, tz: str | None) -> ImageTimes:
    """Read times from a table.

    It has ``timestamp_ns`` (Unix), ``timestamp`` (date and time), or start and end of the exposures.

    Args:
        table: a CSV file.
        key: the column that names the image, such as ``file``.
        tz: IANA zone of times without an offset.

    Raises:
        RecordingError: columns are missing, or a row is not valid.
    """
    header = read_header(table)[0]
    given = next(
        (names for names in (_EXPOSURES, ("timestamp_ns",), ("timestamp",)) if set(names) <= set(header)), None
    )
    if key not in header or given is None:
        lacking = [*([] if key in header else [key]), *([] if given else ["timestamp_ns"])]
        raise RecordingError(
            f"the table lacks {' and '.join(lacking)}", file=table, place="header",
            expected=f"{key} with timestamp_ns, timestamp or {','.join(_EXPOSURES)}, not {','.join(header)}",
            remedy="name the columns so",
        )  # fmt: skip
    rows = read_rows([table], types=dict.fromkeys((key, *given), pa.string()), columns=(key, *given))
    if given == ("timestamp",):
        start = end = parse_stamps(rows, "timestamp", rows.column("timestamp"), tz=tz, date_format=None)
    else:
        start, end = (rows.stamps(name, "unix_ns") for name in (given[0], given[-1]))
    names = rows.column(key).to_pylist()
    missing = np.array([name is None for name in names])
    rows.refuse(missing, key, "missing", expected="the name of an image", remedy="correct the row")
    return ImageTimes(tuple(map(str, names)), start, end, f"table {table.name}")


def parse_time(text: str, tz: str | None, place: str) -> int:
    """Parse a text as Unix nanoseconds: a whole number of nanoseconds, or a date and time.

    Raises:
        RecordingError: it is neither.
    """
    if re.fullmatch(r"[0-9]{16,19}", text):
        return int(text)
    return int(_parse(Path(place), place, [text.replace("T", " ")], tz)[0])


def _from_names(folder: Path, names: list[str], tz: str | None) -> Int64 | None:
    """Times that the names end in, all in one form; None: they do not."""
    stems = [name.rpartition(".")[0] for name in names]
    counts = [_UNIX.search(stem) for stem in stems]
    if all(counts):
        values = []
        for match in counts:
            if match is not None:
                unit = _DIGITS[len(match[1])]
                values.append(int(match[1]) * unit + int(f"{match[2] or '':0<9}"[:9]) * unit // SECOND_NS)
        return np.array(values, np.int64) if len({len(match[1]) for match in counts if match}) == 1 else None
    dates = [_DATE.search(stem) for stem in stems]
    if not all(dates):
        return None
    texts = [
        f"{m[1]}-{m[2]}-{m[3]} {m[4]}:{m[5]}:{m[6]}" + (f".{m[7]}" if m[7] else "") + (" Z" if m[8] else "")
        for m in dates
        if m is not None
    ]
    return _parse(folder, "name", texts, tz)


def _parse(file: Path, column: str, texts: list[str], tz: str | None) -> Int64:
    rows = RecordingRows(pa.table({column: texts}), (file,), (0,))
    return parse_stamps(rows, column, pa.chunked_array([texts]), tz=tz, date_format="YYYY-MM-DD")
