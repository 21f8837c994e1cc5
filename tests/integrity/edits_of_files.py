"""What breaks the rules of documents, files, tables, ledgers and splits."""

from __future__ import annotations

import hashlib
import io
import json
import math
import shutil
from collections.abc import Iterator

import numpy as np
import pyarrow.parquet as pq

from mirror.dataset.layout import MANIFEST, seal
from mirror.dataset.recorded_map import MAP_FILE
from mirror.dataset.splits import make_split
from mirror.schema.documents import ByScene
from mirror.schema.files import write_bytes
from mirror.schema.road_map import MapArea, RoadMap, encode_road_map
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass
from tests.builders.index import segment_folder, tamper
from tests.integrity.clean import FRAME_NS, FRAMES, Broken
from tests.integrity.edit import (
    A0,
    A1,
    B2,
    B2_AGAIN,
    BOXES,
    RECORDED,
    Edit,
    cell,
    cut,
    drop,
    first_image,
    key,
    of,
    place,
    put,
    rename,
    rows,
)

_SCENES = "index/[0-9a-f]*/scenes.parquet"
_SNAPSHOT = "index/snapshots/00000001.json"


def edits() -> Iterator[Edit]:
    yield from _documents()
    yield from _files()
    yield from _tables()
    yield from _ledger()
    yield from _splits()
    yield from _road_maps()


def _documents() -> Iterator[Edit]:
    yield of("DS001", key("dataset.json", schema_version="2.0.0"), "dataset.json", seal=False)
    yield of("DS001", put("dataset.json", b"{"), "dataset.json", seal=False)
    yield of("DS002", put("rois.geojson", b"{}"), "rois.geojson", seal=False)
    yield of("DS003", put("rigs/rig.json", b"{"), "rigs/rig.json", seal=False)
    yield of("DS003", key("rigs/rig.json", rig_id="other"), "rigs/rig.json")
    yield of("DS004", key("drives/d0/drive.json", drive_id=7), "drives/d0/drive.json")
    yield of("DS004", key("drives/d0/drive.json", drive_id="other"), "drives/d0/drive.json", "IDX002", "TAB006")
    yield of("DS005", put(f"{BOXES}/{MANIFEST}", b"[]"), f"{BOXES}/{MANIFEST}", "IDX002", seal=False)
    yield of("DS006", drop(f"{BOXES}/{MANIFEST}"), BOXES)
    yield of("DS007", drop(f"{RECORDED}/{MANIFEST}"), f"{RECORDED}/{MANIFEST}", "DS006", seal=False)
    yield of(
        "DS007",
        lambda broken: broken.document(f"{RECORDED}/{MANIFEST}", lambda raw: raw["derived_from"].update(x="y")),
        f"{RECORDED}/{MANIFEST}",
        seal=False,
    )
    yield of("DS008", _copy_traversal, "traversals/a.d9.1")
    yield of("DS009", rename(BOXES, "petr"), BOXES.replace("petr@1", "petr"), "IDX002")
    yield of("DS009", lambda broken: (broken.root / "drives" / "a b").mkdir(), "drives/a b", "DS006", seal=False)
    yield of(
        "DS009",
        lambda broken: (broken.root / "traversals/x/recorded").mkdir(parents=True),
        "traversals/x",
        "DS006",
        seal=False,
    )
    yield of("DS010", _rename_scene, "rois.geojson", seal=False)
    yield of(
        "DS011", key("drives/d1/drive.json", vehicle_id="car0", vehicle_type="truck"), "drives/d1/drive.json", "TAB006"
    )
    yield of("DS012", drop("rigs/rig.front_left.png"), "rigs/rig.front_left.png")
    yield of("DS012", put("rigs/rig.front_left.png", b"PNG"), "rigs/rig.front_left.png")
    yield of("DS013", key("dataset.json", licence=None), "dataset.json")


def _copy_traversal(broken: Broken) -> None:
    shutil.copytree(broken.root / "traversals" / A0, broken.root / "traversals/a.d9.1")


def _rename_scene(broken: Broken) -> None:
    def change(raw: dict[str, list[dict[str, dict[str, str]]]]) -> None:
        raw["features"][0]["properties"]["scene_id"] = "z"

    broken.document("rois.geojson", change)


def _files() -> Iterator[Edit]:
    yield of("FIL001", drop(f"{BOXES}/boxes.parquet"), f"{BOXES}/boxes.parquet", "IDX003", seal=False)
    yield of("FIL001", drop(_SCENES), _SCENES, seal=False)
    yield of("FIL002", cut(_SCENES, 40), _SCENES, seal=False)
    yield of("FIL003", _flip_byte, _SCENES, seal=False)
    yield of("IDX001", drop("index"), "index", seal=False)
    yield of("IDX001", put(_SNAPSHOT, b"{"), _SNAPSHOT, seal=False)
    yield of("IDX002", drop(f"{BOXES}"), _SNAPSHOT, seal=False)
    yield of("IDX003", _forget_index_rows, "index", seal=False)


def _flip_byte(broken: Broken) -> None:
    file = place(broken, _SCENES)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    write_bytes(file, bytes(data))


def _forget_index_rows(broken: Broken) -> None:
    table = pq.read_table(segment_folder(broken.root) / "row_groups.parquet")
    rows = [row for row in table.to_pylist() if not (row["table"] == "boxes" and row["scene_id"] == "a")]
    sink = io.BytesIO()
    pq.write_table(type(table).from_pylist(rows, schema=table.schema), sink)
    tamper(broken.root, {"row_groups.parquet": sink.getvalue()})


def _tables() -> Iterator[Edit]:
    poses = f"{RECORDED}/ego_poses.parquet"
    unreadable = ("FIL002", "IDX003")
    yield of("TAB001", cut(poses, 500), poses, *unreadable, seal=False)
    yield of("TAB001", _without_column, poses, *unreadable, seal=False)
    yield of("TAB002", cut("drives/d0/passes.parquet", 500), "drives/d0/passes.parquet", "FIL002", seal=False)
    yield of("TAB003", rows(BOXES, "boxes", lambda rows: rows[::-1]), f"{BOXES}/boxes.parquet")
    yield of("TAB004", rows(BOXES, "boxes", lambda rows: [rows[0], *rows]), f"{BOXES}/boxes.parquet")
    yield of("TAB005", cell(A0, "calibrations", 0, stage="best"), f"{RECORDED}/calibrations.parquet")
    yield of("TAB005", cell(A0, "images", 0, privacy="public"), f"{RECORDED}/images.parquet")
    yield of("TAB006", cell(A0, "calibrations", 0, drive_id="d1"), f"{RECORDED}/calibrations.parquet")
    yield of("TAB006", cell(BOXES, "boxes", 0, source_version="2"), f"{BOXES}/boxes.parquet")


def _without_column(broken: Broken) -> None:
    path = broken.path(A0, "ego_poses")
    table = pq.read_table(path).drop_columns(["tx_m"])
    path.unlink()
    pq.write_table(table, path)


def _ledger() -> Iterator[Edit]:
    file = "drives/d0/passes.parquet"
    later = {
        "exit_ns": lambda row: row["entry_ns"] + 9 * SECOND,
        "duration_s": 9.0,
        "path_m": 90.0,
        "inside_path_m": 90.0,
        "mean_speed_mps": 10.0,
    }
    yield of("LED001", cell("d0", "passes", 1, **later), file, "TIM009")
    yield of("LED002", cell("d0", "passes", 0, rule="min_path"), file)
    yield of("LED002", cell("d0", "passes", 0, threshold=5.0), file)
    yield of("LED003", cell("d0", "passes", 0, mean_speed_mps=11.0), file)
    yield of("LED003", cell("d0", "passes", 0, overlap=1.2), file)
    yield of("LED003", cell("d0", "passes", 0, closest_m=math.inf), file, "LED004")
    yield of("LED004", cell("d0", "passes", 0, closest_m=200.5), file)
    yield of(
        "LED005",
        cell("d0", "passes", 1, path_m=132.0, inside_path_m=132.0, mean_speed_mps=12.0),
        f"{RECORDED}/ego_poses.parquet",
    )
    yield of("LED006", cell("d0", "passes", 1, traversal_id="a.d0.1"), file, "IDX002")
    yield of("LED006", cell("d0", "passes", 0, decision="perhaps"), file)
    yield of("LED007", cell("d0", "passes", 0, entry_ns=EPOCH - 2 * SECOND, exit_ns=EPOCH + 2 * SECOND), file)


def _splits() -> Iterator[Edit]:
    file = "splits/s.json"
    yield of("SPL001", put(file, b"{"), file, seal=False)
    yield of("SPL001", key(file, name="other"), file)
    yield of(
        "SPL002", lambda broken: broken.document(file, lambda raw: raw["assignments"].update({"a.x.1": "train"})), file
    )
    yield of("SPL003", _drive_in_two_roles, file)
    yield of("SPL004", _same_image, file)
    yield of("SPL005", _same_time, file, "TIM008")
    yield of("SPL006", _scene_in_two_roles, "splits/t.json")
    yield of(
        "SPL007",
        lambda broken: broken.document(file, lambda raw: raw["manifests"].update({A0: "0" * 64})),
        file,
        seal=False,
    )
    yield of("SPL008", _forgotten, file)


def _assign(broken: Broken, roles: dict[str, str], name: str = "s") -> None:
    def change(raw: dict[str, dict[str, str]]) -> None:
        raw["assignments"].update(roles)
        raw["manifests"].update(dict.fromkeys(roles, ""))

    broken.document(f"splits/{name}.json", change)


def _drive_in_two_roles(broken: Broken) -> None:
    _assign(broken, {B2: "train", B2_AGAIN: "held_out"})


def _same_image(broken: Broken) -> None:
    data = (broken.root / first_image(broken)).read_bytes()
    broken.set(A1, "images", 0, byte_length=len(data), sha256=hashlib.sha256(data).digest())
    write_bytes(broken.root / broken.read(A1, "images")[0]["uri"], data)


def _same_time(broken: Broken) -> None:
    roles = json.loads((broken.root / "splits/s.json").read_text())["assignments"]
    added = add_drive(broken, "d3", vehicle_id="car0", entry_ns=EPOCH + SECOND)
    _assign(broken, {added: roles[A1]})


def add_drive(broken: Broken, drive_id: str, *, vehicle_id: str, entry_ns: int) -> str:
    """A drive without cameras through scene a."""
    kept = {path: path.read_bytes() for path in (broken.layout.document, broken.layout.rois)}
    builder = Builder(broken.root, cameras=())
    builder.scene("a")
    ids = builder.drive(drive_id, [Pass("a", entry_ns, FRAMES, FRAME_NS)], vehicle_id=vehicle_id)
    for path, data in kept.items():
        write_bytes(path, data)
    return ids[0]


def _scene_in_two_roles(broken: Broken) -> None:
    roles = make_split(broken.root, "t", ByScene(train=0.5, val=0, test=0.5)).document.assignments
    _assign(broken, {A0: "train" if roles[A0] == "test" else "test"}, "t")


def _forgotten(broken: Broken) -> None:
    def change(raw: dict[str, dict[str, str]]) -> None:
        del raw["assignments"][A1], raw["manifests"][A1]

    broken.document("splits/s.json", change)


def _road_maps() -> Iterator[Edit]:
    file = "maps/b/map.parquet"
    yield of("MAP001", lambda broken: _add_map(broken, _road("a", "yard")), file)
    yield of("MAP001", lambda broken: _add_map(broken, _road("b", None)), file)
    yield of("MAP001", lambda broken: (_add_map(broken, _road("b", "yard")), cut(file, 500)(broken)), file)
    yield of("MAP002", lambda broken: _add_map(broken, _road("b", "yard", aside_m=50.0)), file)


def _road(scene_id: str, frame: str | None, *, aside_m: float = 0.0) -> RoadMap:
    """A road along x, from kerb to kerb 20 m wide."""
    ring = np.array([[-900.0, -10.0], [900.0, -10.0], [900.0, 10.0], [-900.0, 10.0]]) + np.array([0.0, aside_m])
    return RoadMap(scene_id, frame, False, {}, (MapArea("road", (ring,)),))


def _add_map(broken: Broken, road_map: RoadMap) -> None:
    data = encode_road_map(road_map)
    folder = broken.layout.road_map("b")
    write_bytes(folder / MAP_FILE, data)
    seal(folder, {MAP_FILE: data}, derived_from={})
