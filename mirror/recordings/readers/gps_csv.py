"""Reads any GPS table: columns have usual names, or the user names them.

A file is one drive. A folder of tables is one drive in consecutive files, in the order of their names (numbers are
compared by value). Wild fixes stay in the track: cleaning drops and counts them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Bool, Int64
from mirror.errors import RecordingError
from mirror.recordings.calibration import to_calibration_table
from mirror.recordings.opening import require_file
from mirror.recordings.orientation import ANGLES, QUATERNION, read_orientation
from mirror.recordings.paths import list_folder, natural_key, to_identifier
from mirror.recordings.protocol import DriveInfo, ImageStream, Track
from mirror.recordings.registry import refuse_options
from mirror.recordings.stamps import has_offset, parse_stamps, require_zone
from mirror.recordings.tabular import RecordingRows, read_header, read_rows
from mirror.recordings.time import TIME_BASES
from mirror.recordings.weather import weather_label
from mirror.schema.documents import is_identifier

_TABLES: Final = (".csv", ".tsv")
_NOTES: Final = ("", ".md", ".txt")
_OPTIONS: Final = (
    "columns",
    "tz",
    "date_format",
    "time_unit",
    "delimiter",
    "frame",
    "drive_id",
    "vehicle_id",
    "vehicle_type",
)
_LONG_UNITS: Final = ("ns", "us", "ms", "s")
_USUAL: Final = {
    "time": (
        *(f"{name}_{unit}" for name in ("timestamp", "time", "unix") for unit in _LONG_UNITS),
        *("timestamp", "datetime", "date_time", "utc", "gps_time", "gpstime", "epoch", "unix", "time", "t"),
    ),
    "date": ("date", "day"),
    "lon": ("longitude_deg", "longitude", "lon_deg", "lon", "long", "lng", "gps_lon", "gps_longitude"),
    "lat": ("latitude_deg", "latitude", "lat_deg", "lat", "gps_lat", "gps_latitude"),
    "x": ("x_m", "x"),
    "y": ("y_m", "y"),
    "z": ("z_m", "z"),
    "height": ("height_m", "height", "altitude_m", "altitude", "alt", "elevation", "ele", "gps_alt"),
    "sigma": ("sigma_m", "sigma", "horizontal_accuracy", "hacc", "accuracy"),
    "weather": ("weather",),
    "vehicle": ("vehicle_id", "vehicle"),
}
_GEODETIC: Final = ("lon", "lat", "height")
_LOCAL: Final = ("x", "y", "z")
# 1e8 s since 1970 is the year 1973. Seconds since 1970 reach 1e11 in the year 5138, milliseconds in 1973.
_SMALLEST_UNIX: Final = 1e8
_NUMBER: Final = r"^\s*[+-]?[0-9]+(\.[0-9]*)?\s*$"
_UNIT_BY_MAGNITUDE: Final = ((1e11, "unix_s"), (1e14, "unix_ms"), (1e17, "unix_us"), (np.inf, "unix_ns"))


class CsvReader:
    """A reader of a GPS table, or of a folder of GPS tables."""

    name = "csv"
    expects = "a .csv or .tsv file with time and position, or a folder that holds only such files"

    def recognises(self, path: Path) -> bool:
        """Return whether a file has a table's suffix, or a folder holds only tables, the first with a usual header."""
        if path.is_file():
            return path.suffix.lower() in _TABLES
        children = list(path.iterdir())
        tables = sorted(child for child in children if child.suffix.lower() in _TABLES)
        others = [child for child in children if child not in tables and child.suffix.lower() not in _NOTES]
        if not tables or others or any(child.is_dir() for child in children):
            return False
        usual = _usual_columns(read_header(require_file(path, tables[0].name))[0])
        return "time" in usual and any({*axes[:2]} <= usual.keys() for axes in (_GEODETIC, _LOCAL))

    def open(self, path: Path, options: Mapping[str, str]) -> CsvRecording:
        """Open a table, or a folder of tables; the options are described in docs/recordings/csv.md."""
        refuse_options(options, _OPTIONS, path, self.name)
        if "frame" in options and not is_identifier(options["frame"]):
            raise RecordingError(
                f"{options['frame']!r} is not a valid frame name",
                file=path,
                place="option frame",
                expected="letters, digits, _ and -",
            )
        if path.is_file():
            files = [path]
        else:
            listed = list_folder(path, path)
            names = sorted((name for name in listed if Path(name).suffix.lower() in _TABLES), key=natural_key)
            files = [listed[name] for name in names]
        if not files:
            raise RecordingError("no tables", file=path, expected=" or ".join(f"*{suffix}" for suffix in _TABLES))
        return CsvRecording(path, tuple(files), dict(options))


@dataclass(frozen=True)
class CsvRecording:
    """A drive with poses and no cameras."""

    path: Path
    tables: tuple[Path, ...]
    options: Mapping[str, str]

    @property
    def _axes(self) -> tuple[str, ...]:
        """The roles of the columns that hold a position."""
        return _LOCAL if "frame" in self.options else _GEODETIC

    @cached_property
    def _columns(self) -> dict[str, tuple[str, ...]]:
        """Column names by role; ``time`` may be several columns, joined by a blank."""
        names, _ = read_header(self.tables[0], self.options.get("delimiter"))
        columns = _usual_columns(names)
        columns |= _stated_columns(self.options.get("columns", ""), names, self.tables[0])
        missing = [role for role in ("time", *self._axes[:2]) if role not in columns]
        if missing and "frame" not in self.options and {"x", "y"} <= columns.keys():
            raise RecordingError(
                f"positions in metres ({', '.join(columns[role][0] for role in ('x', 'y'))}) without a frame name",
                file=self.tables[0],
                place="header",
                expected="longitude and latitude, or the name of the local metric frame of x and y",
                remedy="name the frame, the same for all drives in it: --option frame=<name>",
            )
        if missing:
            raise RecordingError(
                f"no column is known as {' or '.join(missing)}",
                file=self.tables[0],
                place="header",
                expected=f"usual names among {', '.join(names)}",
                remedy=f"name them: --columns {','.join(f'{role}=<name of the column>' for role in missing)}",
            )
        return columns

    @cached_property
    def _rows(self) -> RecordingRows:
        _, delimiter = read_header(self.tables[0], self.options.get("delimiter"))
        roles = {"time", *self._axes, "sigma", "weather", "vehicle"}
        columns = {role: names for role, names in self._columns.items() if role in roles}
        numbers = {columns[role][0]: pa.float64() for role in (*self._axes, "sigma") if role in columns}
        words = {columns[role][0]: pa.string() for role in ("weather", "vehicle") if role in columns}
        stamps = {name: pa.string() for name in columns["time"]}
        turns = [name for name in read_header(self.tables[0], delimiter)[0] if name in (*QUATERNION, *ANGLES)]
        numbers |= dict.fromkeys(turns, pa.float64())
        used = list(dict.fromkeys([*(name for names in columns.values() for name in names), *turns]))
        types = {**words, **numbers, **stamps}
        return read_rows(self.tables, types=types, columns=used, delimiter=delimiter, tolerant=True)

    @cached_property
    def _stamps(self) -> tuple[Int64, str, bool]:
        """Unix nanoseconds, a description of the time base, and whether it has a date."""
        rows, names = self._rows, self._columns["time"]
        parts = [pc.fill_null(rows.column(name), "") for name in names]
        text = parts[0] if len(parts) == 1 else pc.binary_join_element_wise(*parts, " ")
        label = "+".join(names)
        # The form of most rows decides; the other rows are bad.
        numeric = np.asarray(pc.match_substring_regex(text, _NUMBER))
        if len(names) == 1 and 0 < np.count_nonzero(pc.not_equal(text, "")) <= 2 * np.count_nonzero(numeric):
            if "tz" in self.options:
                require_zone(self.options["tz"])
            base = self._time_base(names[0], text.filter(pa.array(numeric)), numeric)
            stamps, words, has_date = rows.stamps(names[0], base), TIME_BASES[base].words, TIME_BASES[base].has_date
        else:
            tz = self.options.get("tz")
            has_date = True
            stamps = parse_stamps(rows, label, text, tz=tz, date_format=self.options.get("date_format"))
            stated = has_offset(text)[rows.good]
            local = "date and time," if not stated.any() else "date and time with UTC offset, or else"
            words = "date and time with UTC offset" if stated.all() else f"{local} local in {tz}"
        self._require_sequence(stamps)
        return stamps, words, has_date

    def _time_base(self, name: str, numbers: pa.ChunkedArray, numeric: Bool) -> str:
        """The time base of a column of numbers; if their size decides it, rows of another size are bad."""
        unit = self.options.get("time_unit")
        if unit is None and "_" in name and name.rpartition("_")[2].lower() in _LONG_UNITS:
            unit = name.rpartition("_")[2].lower()
        if unit is not None:
            return unit if unit in TIME_BASES else f"unix_{unit}"
        sizes = np.abs(np.asarray(pc.utf8_trim_whitespace(numbers).cast(pa.float64())))
        middle = float(np.median(sizes))
        text = self._rows.column(name)

        def problem(row: int) -> str:
            return f"{text[row].as_py()} is not a time since 1970 in any unit"

        expected = "seconds, milliseconds, microseconds or nanoseconds since 1970"
        if middle < _SMALLEST_UNIX:
            raise self._rows.error(
                int(np.argmax(numeric)),
                name,
                problem(int(np.argmax(numeric))),
                expected=expected,
                remedy="convert the logger's own clock to Unix time, or state that it has no date: --option"
                " time_unit=clock_s",
            )
        small: Bool = np.zeros(len(text), np.bool_)
        small[numeric] = sizes < _SMALLEST_UNIX
        self._rows.refuse(small, name, problem, expected=expected, remedy="correct or remove the row", reason="time")
        return next(base for limit, base in _UNIT_BY_MAGNITUDE if middle < limit)

    def _require_sequence(self, stamps: Int64) -> None:
        rows = self._rows
        ends = (*rows.starts[1:], len(rows))
        first = [stamps[low:high][rows.good[low:high]][:1] for low, high in zip(rows.starts, ends)]
        dated = [index for index, stamp in enumerate(first) if len(stamp)]
        late = np.diff([int(first[index][0]) for index in dated]) < 0
        if late.any():
            before, after = (dated[int(np.argmax(late)) + step] for step in (0, 1))
            raise RecordingError(
                f"starts before {self.tables[before].name} does",
                file=self.tables[after],
                expected="consecutive files of one drive, in the order of their names",
                remedy="ingest the files one by one if each is a separate drive",
            )

    @cached_property
    def info(self) -> DriveInfo:
        """The drive; ids come from the options or the name, the weather is the most frequent word of its column."""
        path = self.path.resolve()
        name = path.stem if path.is_file() else path.name
        return DriveInfo(
            drive_id=to_identifier(self.options.get("drive_id", name)),
            vehicle_id=to_identifier(self.options.get("vehicle_id") or self._vehicle()),
            vehicle_type=self.options.get("vehicle_type", "unknown"),
            time_base=self._stamps[1],
            frame=self.options.get("frame"),
            weather=self._weather(),
            has_date=self._stamps[2],
        )

    def _vehicle(self) -> str:
        if "vehicle" not in self._columns:
            return "unknown"
        name = self._columns["vehicle"][0]
        vehicles = self._rows.column(name).drop_null().unique().to_pylist()
        if len(vehicles) > 1:
            raise RecordingError(
                f"rows of {len(vehicles)} vehicles: {', '.join(vehicles[:3])} ...",
                file=self.tables[0],
                place=f"column {name}",
                expected="one drive of one vehicle",
                remedy="split the table by vehicle and drive, or state one: --option vehicle_id=<id>",
            )
        return str(vehicles[0]) if vehicles else "unknown"

    def _weather(self) -> str | None:
        if "weather" not in self._columns:
            return None
        words = Counter(self._rows.column(self._columns["weather"][0]).drop_null().to_pylist())
        return weather_label(words.most_common(1)[0][0]) if words else None

    @property
    def rig(self) -> None:
        """None: tables have no cameras."""
        return

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return the tables."""
        return [(file.name, file) for file in sorted(self.tables)]

    def track(self) -> Track:
        """Return all fixes; a height is above the ellipsoid, or z of the local frame."""
        stamps = self._stamps[0]
        names = ("x_m", "y_m") if "frame" in self.options else ("longitude_deg", "latitude_deg")
        columns: dict[str, Any] = {
            name: self._rows.floats(self._columns[role][0])
            for name, role in zip((*names, "height_m"), self._axes)
            if role in self._columns
        }
        if "sigma" in self._columns:
            columns["sigma_m"] = self._rows.sigmas(self._columns["sigma"][0])
        columns["rotation"] = read_orientation(self._rows)[0]
        return self._rows.without_bad(Track(stamps, **columns, file=self.tables[0]))

    def calibrations(self) -> pa.Table:
        """Return a table without rows."""
        return to_calibration_table([], vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def images(self) -> Mapping[str, ImageStream]:
        """Return no streams."""
        return {}

    def boxes(self) -> None:
        """Return None: tables have no boxes."""
        return


def _usual_columns(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Columns with a usual name, by role; a date column and a time column together are the time."""
    by_key = {name.strip().lower().replace(" ", "_"): name for name in reversed(names)}
    columns: dict[str, tuple[str, ...]] = {}
    for role, usual in _USUAL.items():
        match = next((by_key[name] for name in usual if name in by_key), None)
        if match is not None:
            columns[role] = (match,)
    date = columns.pop("date", None)
    if date and "time" in by_key:
        columns["time"] = (*date, by_key["time"])
    return columns


def _stated_columns(text: str, names: Sequence[str], file: Path) -> dict[str, tuple[str, ...]]:
    """Parse the option ``columns``, for instance ``time=Date+Time,lon=LON``: column names by role."""
    stated = {}
    for part in filter(None, text.split(",")):
        role, _, columns = part.partition("=")
        columns_of_role = tuple(columns.split("+")) if role == "time" and columns not in names else (columns,)
        absent = [name for name in columns_of_role if name not in names]
        if role not in _USUAL or role == "date" or absent:
            known = [name for name in _USUAL if name != "date"]
            raise RecordingError(
                f"{part!r} names no column" if absent else f"{role!r} is not a role of a column",
                file=file,
                place="option columns",
                expected=f"one of {', '.join(names)}" if absent else f"one of {', '.join(known)}",
            )
        stated[role] = columns_of_role
    return stated
