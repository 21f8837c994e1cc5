"""The tables of a rollout: the state log and the road map, and the headers in their files' metadata.

See `mirror.schema.tables` for the form of a table.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, TypeVar

import pyarrow as pa
import pyarrow.parquet as pq

from mirror.errors import SchemaError
from mirror.schema.documents import Document
from mirror.schema.files import parse_json
from mirror.schema.tables import BBOX, KEY, Table

Header = TypeVar("Header", bound=Document)


def read_header(path: Path, key: bytes, model: type[Header], *, data: bytes | None = None) -> Header:
    """Read the document in a Parquet file's metadata that describes the table as a whole.

    Args:
        path: the file.
        key: key of the metadata.
        model: model of the document.
        data: bytes of the file; None: it is opened.

    Raises:
        SchemaError: the file has no such document, or it does not follow the model.
    """
    stored = (pq.read_schema(path if data is None else pa.BufferReader(data)).metadata or {}).get(key)
    if stored is None:
        raise SchemaError(
            f"no metadata {key.decode()!r}", file=path, expected=f"a {model.__name__} document, as MIRROR writes it"
        )
    return parse_json(stored, model, path)


def _field(name: str, kind: pa.DataType, doc: str, *, null: bool = False) -> pa.Field:
    return pa.field(name, kind, nullable=null, metadata={"doc": doc})


_NUMBER: Final = pa.float64()
_TEXTS: Final = pa.list_(pa.string())

STATES: Final = Table(
    name="states",
    row="the state of one actor at one instant; the ego is the first row of each instant",
    place="<run>/states.parquet",
    schema=pa.schema(
        [
            _field("timestamp_ns", pa.int64(), "Unix time, UTC."),
            _field("actor_id", pa.string(), "Id, unique in the log; `ego` for the ego vehicle."),
            _field("category", KEY, "Category of the road user."),
            _field("x_m", _NUMBER, "Centre of the box, in the scene's frame."),
            _field("y_m", _NUMBER, "Centre of the box, in the scene's frame."),
            _field("z_m", _NUMBER, "Height of the middle of the box's underside; null: unknown.", null=True),
            _field("yaw_rad", _NUMBER, "Heading, counter-clockwise from x."),
            _field("pitch_rad", _NUMBER, "Nose up is positive; null: unknown.", null=True),
            _field("roll_rad", _NUMBER, "Left side up is positive; null: unknown.", null=True),
            _field("vx_mps", _NUMBER, "Velocity of the centre over ground, along x of the scene's frame."),
            _field("vy_mps", _NUMBER, "Velocity of the centre over ground, along y of the scene's frame."),
            _field("length_m", _NUMBER, "Extent along the heading."),
            _field("width_m", _NUMBER, "Extent across the heading."),
            _field("height_m", _NUMBER, "Extent upwards; null: unknown.", null=True),
            _field("acceleration_mps2", _NUMBER, "Acceleration along the heading; null: unknown.", null=True),
            _field(
                "steering_rad", _NUMBER, "Angle of the front wheels, positive to the left; null: unknown.", null=True
            ),
            _field(
                "signals",
                _TEXTS,
                "In the ego's row: states of the signals in the order of the file's metadata: `green`, `amber`, `red`"
                " or `red_amber`; null in the other rows.",
                null=True,
            ),
        ]
    ),
    sorted_by=("timestamp_ns",),
)

ROAD_MAP: Final = Table(
    name="road_map",
    row="one feature of a scene's map: a lane, a part of the drivable area, a crossing or a signal (GeoParquet)",
    place="<run>/map.parquet`, in a dataset `maps/<scene_id>/map.parquet`, or beside the recordings of `mirror synth`"
    " `maps/<scene_id>.parquet",
    schema=pa.schema(
        [
            _field("feature", KEY, "`lane`, `drivable`, `crossing` or `signal`."),
            _field("feature_id", pa.string(), "Id, unique among the features of its kind."),
            _field("kind", KEY, "Of a lane: `drive`, `turn`, `park`, `cycle`, `walk` or `cross`.", null=True),
            _field("width_m", pa.list_(_NUMBER), "Of a lane: its width at each point of its middle line.", null=True),
            _field("speed_limit_mps", _NUMBER, "Of a lane; null: unknown.", null=True),
            _field("successors", _TEXTS, "Of a lane: lanes that begin where it ends.", null=True),
            _field("predecessors", _TEXTS, "Of a lane: lanes that end where it begins.", null=True),
            _field("left", pa.string(), "Of a lane: the neighbour on the left with the same direction.", null=True),
            _field("right", pa.string(), "Of a lane: the neighbour on the right with the same direction.", null=True),
            _field("stop_m", _NUMBER, "Of a lane: distance of its stop line from its beginning.", null=True),
            _field("signal", pa.string(), "Of a lane: the signal that controls its end.", null=True),
            _field("yields_to", _TEXTS, "Of a lane: lanes that have the right of way over it.", null=True),
            _field("phase_states", _TEXTS, "Of a signal: states in the order of its cycle.", null=True),
            _field("phase_s", pa.list_(_NUMBER), "Of a signal: durations of these states.", null=True),
            _field("offset_s", _NUMBER, "Of a signal: time at which the first state begins.", null=True),
            _field(
                "geometry",
                pa.binary(),
                "WKB in the scene's frame, metres: the middle line of a lane (LineString Z, in driving direction), the"
                " outline of a part of the drivable area or of a crossing (Polygon); null for a signal.",
                null=True,
            ),
            _field("bbox", BBOX, "Bounding box covering of `geometry`.", null=True),
        ]
    ),
    sorted_by=("feature", "feature_id"),
)

ROLLOUT: Final = (STATES, ROAD_MAP)
