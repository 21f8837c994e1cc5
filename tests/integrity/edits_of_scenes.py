"""What breaks the rules of poses, places, times, cameras, images and boxes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator

import numpy as np

from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import MANIFEST
from mirror.dataset.redaction import current_redaction
from mirror.schema.files import write_bytes
from mirror.schema.tables import CALIBRATIONS, IMAGES
from tests.builders.dataset import EPOCH, SECOND
from tests.integrity.clean import FRAME_NS, FRAMES, SIZE, Broken, TableRows, jpeg, png
from tests.integrity.edit import (
    A0,
    B2,
    BOXES,
    DEPTH,
    HOUR,
    LEFT,
    LIDARS,
    MASKS,
    POINTS,
    RECORDED,
    WIDE,
    Edit,
    cell,
    first_image,
    image,
    key,
    of,
    plus,
    rows,
)


def edits() -> Iterator[Edit]:
    yield from _poses()
    yield from _geography()
    yield from _time()
    yield from _cameras()
    yield from _images()
    yield from _boxes()
    yield from _lidars()
    yield from _reconstruction()
    yield from _privacy()


def _lidars() -> Iterator[Edit]:
    file = f"{LIDARS}/lidars.parquet"
    yield of("LID001", cell(LIDARS, "lidars", 2, uri="/fleet/gone.npz"), file)
    yield of("LID002", cell(LIDARS, "lidars", 0, timestamp_ns=plus("timestamp_ns", -HOUR)), file)
    yield of("LID003", cell(LIDARS, "lidars", 1, qw=0.5), file)
    yield of("LID003", cell(LIDARS, "lidars", 1, tx_m=float("nan")), file)


def _poses() -> Iterator[Edit]:
    file = f"{RECORDED}/ego_poses.parquet"
    # Poses are 0.1 s apart; the first is 1 s before the entry.
    yield of("POS001", cell(A0, "ego_poses", 50, timestamp_ns=plus("timestamp_ns", -200_000_000)), file)
    yield of("POS002", cell(A0, "ego_poses", 50, sigma_m=float("inf")), file)
    yield of("POS002", cell(B2, "ego_poses", 50, tx_m=float("nan")), None)
    yield of("POS003", cell(A0, "ego_poses", 50, qw=0.9), file)
    yield of(
        "POS004", cell(A0, "ego_poses", range(200), **{name: _minus(name) for name in ("qw", "qx", "qy", "qz")}), file
    )
    yield of("POS005", rows(A0, "ego_poses", lambda rows: rows[:60] + rows[81:]), file)
    yield of("POS006", cell(B2, "ego_poses", range(60, 500), tx_m=plus("tx_m", 30.0)), None, "POS007", "LED005")
    yield of("POS007", cell(B2, "ego_poses", range(60, 500), tx_m=plus("tx_m", 4.0)), None, "LED005")
    yield of("POS008", cell(B2, "ego_poses", range(60, 62), qw=np.sqrt(0.5), qz=np.sqrt(0.5)), None)
    yield of("POS009", _freeze, None, "POS006", "POS007")
    yield of("POS009", _turn_on_the_spot, None, "LED005", "BOX005")
    yield of("POS010", rows(B2, "ego_poses", lambda rows: rows[:11] + rows[12:100]), None, "POS011", "IDX002")
    yield of("POS011", rows(B2, "ego_poses", lambda rows: rows[12:]), None, "POS010", "BOX007", "IDX002")
    yield of("POS012", _late_start, None)


def _minus(name: str) -> Callable[[dict[str, float]], float]:
    return lambda row: -row[name]


def _freeze(broken: Broken) -> None:
    def change(rows: TableRows) -> TableRows:
        for row in rows[60:75]:
            row |= {name: rows[60][name] for name in ("tx_m", "ty_m")}
        return rows

    broken.rows(B2, "ego_poses", change)


def _turn_on_the_spot(broken: Broken) -> None:
    """The vehicle never leaves its place, which a parked one may, but it turns by 20 degrees."""

    def change(rows: TableRows) -> TableRows:
        for number, row in enumerate(rows):
            half = np.radians(60.0 + 20.0 * number / len(rows)) / 2
            row |= {"tx_m": 0.0, "ty_m": 0.0, "qw": np.cos(half), "qx": 0.0, "qy": 0.0, "qz": np.sin(half)}
        return rows

    broken.rows(B2, "ego_poses", change)


def _late_start(broken: Broken) -> None:
    broken.rows(B2, "ego_poses", lambda rows: rows[7:])
    broken.document("drives/d2/drive.json", lambda raw: raw.update(start_ns=raw["start_ns"] - HOUR))


def _geography() -> Iterator[Edit]:
    file = f"{RECORDED}/ego_poses.parquet"
    yield of("GEO001", cell(A0, "ego_poses", range(200), tz_m=plus("tz_m", 0.02)), file)
    yield of("GEO002", cell(B2, "ego_poses", range(60, 200), tz_m=plus("tz_m", 3.0)), None)
    yield of("GEO003", cell(B2, "ego_poses", range(200), qw=0.0, qz=1.0), None, "BOX005")
    yield of("GEO004", cell(B2, "ego_poses", range(200), **_rolled(40.0)), None)
    yield of("GEO005", _overlapping_scene, "rois.geojson")


def _rolled(degrees: float) -> dict[str, float]:
    """The builder's heading of 30 degrees, and a roll."""
    yaw, roll = np.radians(60.0) / 2, np.radians(degrees) / 2
    parts = (
        np.cos(yaw) * np.cos(roll),
        np.cos(yaw) * np.sin(roll),
        np.sin(yaw) * np.sin(roll),
        np.sin(yaw) * np.cos(roll),
    )
    return dict(zip(("qw", "qx", "qy", "qz"), map(float, parts)))


def _overlapping_scene(broken: Broken) -> None:
    def change(raw: dict[str, list[dict[str, dict[str, object]]]]) -> None:
        properties = dict(raw["features"][1]["properties"])
        raw["features"].append({"type": "Feature", "geometry": None, "properties": {**properties, "scene_id": "c",
                                                                                  "x_m": 299.0}})  # type: ignore[dict-item] # fmt: skip

    broken.document("rois.geojson", change)


def _time() -> Iterator[Edit]:
    file = f"{RECORDED}/images.parquet"
    mid = plus("timestamp_ns", 10_000_000)
    yield of(
        "TIM001",
        cell(A0, "images", 3, exposure_start_ns=mid, exposure_end_ns=plus("exposure_end_ns", 20_000_000)),
        file,
    )
    yield of("TIM002", cell(A0, "images", 3, exposure_start_ns=plus("exposure_start_ns", -2 * FRAME_NS)), file)
    late = {name: plus(name, 0.55 * FRAME_NS) for name in ("timestamp_ns", "exposure_start_ns", "exposure_end_ns")}
    whole = {name: (lambda row, change=change: int(change(row))) for name, change in late.items()}
    yield of("TIM003", cell(A0, "images", 3, **whole), file, "TIM005")
    yield of("TIM004", cell(A0, "images", 2 * FRAMES + 3, frame_index=None), file)
    yield of("TIM004", cell(A0, "images", WIDE, frame_index=plus("frame_index", 1)), file, "TIM003")
    yield of("TIM005", _lost_frame, file)
    yield of("TIM006", cell(A0, "images", 3, frame_index=None), file)
    yield of("TIM007", cell(MASKS, "masks", 0, timestamp_ns=0), f"{MASKS}/masks.parquet", "MSK002")
    yield of("TIM008", key("drives/d1/drive.json", vehicle_id="car0", start_ns=EPOCH), "drives/d1/drive.json", "TAB006")
    yield of("TIM009", _image_before_entry, file, "MSK002", "DEP002")


def _lost_frame(broken: Broken) -> None:
    """Frame 5 is missing in all cameras, and those behind it are counted on."""

    def change(rows: TableRows) -> TableRows:
        kept = [row for row in rows if row["frame_index"] != 5]
        for row in kept:
            row["frame_index"] -= row["frame_index"] > 5
        return kept

    broken.rows(A0, "images", change)


def _image_before_entry(broken: Broken) -> None:
    names = ("timestamp_ns", "exposure_start_ns", "exposure_end_ns")
    # The first image of one camera, a fifth of a period early.
    broken.set(A0, "images", 0, **{name: plus(name, -FRAME_NS // 5) for name in names})


def _cameras() -> Iterator[Edit]:
    file = f"{RECORDED}/calibrations.parquet"
    images = f"{RECORDED}/images.parquet"
    yield of("CAM001", cell(A0, "calibrations", 0, valid_to_ns=EPOCH + 3 * SECOND), images)
    yield of("CAM002", cell(A0, "calibrations", 0, width_px=SIZE[0] + 16, cx_px=32.0), images)
    yield of("CAM003", cell(A0, "calibrations", 0, fx_px=-40.0), file)
    yield of("CAM003", cell(A0, "calibrations", 0, distortion=[0.1]), file)
    yield of("CAM004", cell(A0, "calibrations", 0, fx_px=60.0), file)
    yield of("CAM005", cell(A0, "calibrations", 0, model="brown_conrady", distortion=[-1.5, 0, 0, 0, 0]), file)
    yield of("CAM006", cell(A0, "calibrations", 0, qw=0.9), file)
    yield of("CAM007", cell(A0, "calibrations", 0, covariance=np.diag([1, 1, 1, 1, 1, -1.0]).ravel().tolist()), file)
    yield of("CAM007", cell(A0, "calibrations", 0, covariance=[1.0] * 35), file)
    yield of("CAM008", cell(A0, "calibrations", 0, valid_from_ns=EPOCH + HOUR, valid_to_ns=EPOCH), file, "CAM001")
    yield of("CAM008", _overlapping_validity, file)
    yield of("CAM009", cell(A0, "calibrations", 0, ty_m=-0.5), file)
    yield of("CAM010", _second_stage, file)
    yield of("CAM011", cell(A0, "images", LEFT, camera="a_camera"), images, "CAM001", "CAM012", "MSK002", "DEP002")
    yield of("CAM012", _silent, images, "MSK002", "DEP002")
    yield of("CAM013", _jump, file)
    yield of("CAM014", cell(A0, "calibrations", 0, stage="refined", covariance=None), file)
    yield of("CAM016", cell(A0, "calibrations", 0, shutter_direction="top_to_bottom", readout_ns=10**12), file)
    yield of("CAM015", _stale_calibrations, f"traversals/{A0}/layers/calibrations/refined@1")


def _stale_calibrations(broken: Broken) -> None:
    writer = LayerWriter(broken.layout, A0, "calibrations", "refined", "1")
    writer.finish(CALIBRATIONS, broken.read(A0, "calibrations"), {f"traversal:{A0}": "0" * 64, "settings": "1" * 64})


def _overlapping_validity(broken: Broken) -> None:
    broken.rows(A0, "calibrations", lambda rows: [rows[0], {**rows[0], "valid_from_ns": EPOCH}, *rows[1:]])


def _jump(broken: Broken) -> None:
    def change(rows: TableRows) -> TableRows:
        until, after = {**rows[0], "valid_to_ns": EPOCH}, {**rows[0], "valid_from_ns": EPOCH}
        return [until, {**after, "tx_m": rows[0]["tx_m"] + 0.1}, *rows[1:]]

    broken.rows(A0, "calibrations", change)


def _second_stage(broken: Broken) -> None:
    turn = np.radians(0.5) / 2
    # The mounting turned by half a degree about the camera's x: (q0, q) (cos, sin, 0, 0).
    w, x, y, z = 0.5, -0.5, 0.5, -0.5
    c, s = np.cos(turn), np.sin(turn)
    turned = {"qw": w * c - x * s, "qx": w * s + x * c, "qy": y * c + z * s, "qz": z * c - y * s}
    broken.rows(A0, "calibrations", lambda rows: [rows[0], {**rows[0], **turned, "stage": "online"}, *rows[1:]])


def _silent(broken: Broken) -> None:
    broken.rows(A0, "images", lambda rows: [row for row in rows if row["camera"] != "front_left"])


def _images() -> Iterator[Edit]:
    file = f"{RECORDED}/images.parquet"
    yield of("IMG001", lambda broken: (broken.root / first_image(broken)).unlink(), file)
    yield of("IMG002", lambda broken: write_bytes(broken.root / first_image(broken), jpeg(1)[:100]), file, seal=False)
    yield of("IMG002", cell(A0, "images", 0, byte_length=plus("byte_length", -2)), file, "IMG003", "IMG004")
    yield of("IMG003", lambda broken: image(broken, 0, jpeg(1)[:-40]), file)
    yield of("IMG004", cell(A0, "images", 0, sha256=bytes(32)), file)
    yield of("IMG005", lambda broken: image(broken, 0, b"nothing\xff\xd9"), file)
    yield of("IMG006", lambda broken: image(broken, 0, jpeg(1, (40, 32))), file)
    yield of("IMG007", lambda broken: image(broken, 0, _black()), file)
    yield of("IMG008", _frozen_camera, file)
    yield of("IMG009", cell(A0, "images", 0, privacy="raw"), file)
    yield of("IMG010", cell(A0, "images", 0, uri="../../etc/passwd"), file)
    yield of("IMG011", key(f"{RECORDED}/{MANIFEST}", pictures={"count": 1, "bytes": 1}), file, "DS007", seal=False)
    yield of("IMG013", cell(A0, "images", 0, sha256=None), file)
    yield of("IMG012", cell(A0, "images", 0, video_pts=7), file)


def _black() -> bytes:
    import cv2

    return bytes(cv2.imencode(".jpg", np.zeros((*SIZE[::-1], 3), np.uint8))[1])


def _frozen_camera(broken: Broken) -> None:
    one = broken.root / first_image(broken)
    image(broken, 1, one.read_bytes())


def _boxes() -> Iterator[Edit]:
    file, masks = f"{BOXES}/boxes.parquet", f"{MASKS}/masks.parquet"
    yield of("BOX001", cell(BOXES, "boxes", 0, width_m=0.0), file)
    yield of("BOX001", cell(BOXES, "boxes", 0, vz_mps=float("inf")), file)
    yield of("BOX002", cell(BOXES, "boxes", 0, qw=0.9), file)
    yield of("BOX003", cell(BOXES, "boxes", range(0, 10, 2), tx_m=-15.0), file)
    yield of("BOX004", cell(BOXES, "boxes", 4, category="truck"), file)
    yield of("BOX005", cell(BOXES, "boxes", range(1, 10, 2), vx_mps=-10.0), file)
    yield of("BOX006", cell(BOXES, "boxes", 0, score=1.5), file)
    yield of("BOX007", cell(BOXES, "boxes", range(8, 10), timestamp_ns=EPOCH + HOUR), file)
    yield of("MSK001", cut_mask, masks)
    yield of("MSK001", cell(MASKS, "masks", 0, uri=f"{MASKS}/nothing.png"), masks)
    yield of("MSK003", cell(MASKS, "masks", 1, sha256=bytes(32)), masks)
    yield of("MSK002", cell(MASKS, "masks", 2, timestamp_ns=plus("timestamp_ns", 1)), masks)


def _reconstruction() -> Iterator[Edit]:
    maps, points = f"{DEPTH}/depth.parquet", f"{POINTS}/points.parquet"
    yield of("DEP001", cell(DEPTH, "depth", 0, byte_length=plus("byte_length", 1)), maps)
    yield of("DEP001", cell(DEPTH, "depth", 0, uri=f"{DEPTH}/nothing.png"), maps)
    yield of("DEP002", cell(DEPTH, "depth", 2, timestamp_ns=plus("timestamp_ns", 1)), maps)
    yield of("DEP003", cell(DEPTH, "depth", 1, sha256=bytes(32)), maps)
    yield of("DEP004", cell(DEPTH, "depth", 1, fx_px=0.0), maps)
    yield of("DEP004", cell(DEPTH, "depth", 1, cy_px=float("nan")), maps)
    yield of("DEP004", cell(DEPTH, "depth", 1, height_px=0), maps)
    yield of("PTS001", cell(POINTS, "points", 1, z_m=float("inf")), points)
    yield of("PTS001", cell(POINTS, "points", 1, views=-1), points)
    yield of("PTS001", cell(POINTS, "points", 0, sigma_m=0.0), points)
    yield of("TAB005", cell(POINTS, "points", 0, kind="sky"), points)
    yield of("TAB006", cell(DEPTH, "depth", range(3), source="other"), maps)


def cut_mask(broken: Broken) -> None:
    uri = broken.read(MASKS, "masks")[0]["uri"]
    write_bytes(broken.root / uri, png(np.zeros((2, 2), np.uint8)))


def _privacy() -> Iterator[Edit]:
    folder = f"traversals/{A0}/layers/redaction/made@1"
    yield of("PRV001", lambda broken: _redact(broken, 1), f"{RECORDED}/images.parquet")
    yield of("PRV002", lambda broken: _redact(broken, 0, derived=True), f"traversals/{A0}/layers/depth/sweep@1")
    yield of("PRV003", lambda broken: image(broken, 0, _commented()), f"{RECORDED}/images.parquet")
    yield of("PRV004", lambda broken: _redact(broken, 0, log=False), folder)
    yield of("PRV005", lambda broken: _redact(broken, 0, source=bytes(32)), f"{folder}/log.jsonl")


def _redact(
    broken: Broken, left_out: int, *, derived: bool = False, log: bool = True, source: bytes | None = None
) -> None:
    """A layer that replaces images by themselves; without `derived`, depth and points follow from it."""
    writer = LayerWriter(broken.layout, A0, "redaction", "made", "1")
    rows = broken.read(A0, "images")[left_out:]
    if log:
        lines = [
            {"camera": row["camera"], "timestamp_ns": row["timestamp_ns"],
             "source_sha256": (source or row["sha256"]).hex()}
            for row in rows
        ]  # fmt: skip
        writer.document("log.jsonl", "".join(f"{json.dumps(line)}\n" for line in lines).encode())
    writer.finish(IMAGES, rows, {})
    for kind in () if derived else ("depth", "points"):
        path = f"traversals/{A0}/layers/{kind}/sweep@1/{MANIFEST}"
        current = current_redaction(broken.layout, A0)
        broken.document(path, lambda raw, current=current: raw["derived_from"].update(redaction=current))


def _commented() -> bytes:
    data = jpeg(1)
    return data[:2] + b"\xff\xfe\x00\x06abcd" + data[2:]
