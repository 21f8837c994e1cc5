"""Releases: what is built, what a check finds, and what is withdrawn."""

from __future__ import annotations

import base64
import datetime
import io
import json
import shutil
import threading
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

import mirror
from mirror.cli.main import main
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout, complete_manifest, seal
from mirror.dataset.recorded_map import MAP_FILE
from mirror.dataset.splits import make_split
from mirror.geometry.poses import COLUMNS
from mirror.integrity import check
from mirror.privacy.log import Review, encode_log, read_log
from mirror.privacy.release.check import check_release, find_leaving
from mirror.privacy.release.document import Release
from mirror.privacy.release.review import ReviewSession, review_server
from mirror.privacy.release.sample import choose_sample, miss_bound
from mirror.privacy.release.tree import read_plate_regions
from mirror.privacy.release.vault import Vault
from mirror.progress import NullProgress
from mirror.schema.documents import NovelTraversal
from mirror.schema.files import read_json, read_table, write_json
from mirror.schema.road_map import write_road_map
from mirror.schema.tables import IMAGES, LIDARS, MASKS
from tests.builders.dataset import Builder, encode_rows, write_reconstruction
from tests.builders.index import segment_folder
from tests.metrics.safety.streets import two_way_street
from tests.privacy.conftest import FACE, RED, marked, write_image
from tests.privacy.images import jpeg

WORDS = ("--name", "street", "--licence", "CC-BY-4.0", "--contact", "privacy@example.org")


FLEET_FILE = "/fleet/car-7/sweep.npz"


def build(dataset: Path, out: Path, *words: str) -> int:
    return main(["release", "build", str(dataset), "--out", str(out), *WORDS, *words])


@pytest.fixture(scope="session")
def released(deidentified: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A release with new ids and shifted clocks; tests copy it before they change it."""
    folder = tmp_path_factory.mktemp("released")
    dataset = Path(shutil.copytree(deidentified, folder / "dataset"))
    make_split(dataset, "novel", NovelTraversal(train=1, held_out=1), seed=0)
    builder = object.__new__(Builder)
    builder.layout = Layout(dataset)
    opened = mirror.open(str(dataset))
    name = opened.traversals()[0]
    stamp = opened.where(traversal=name).table("images", ["timestamp_ns"]).column(0)[0].as_py()
    write_reconstruction(builder, name, "front_wide", stamp)
    pose = {key: float(key == "qw") for key in COLUMNS}
    sweep = {"sensor": "top", "timestamp_ns": stamp, "format": "dgp_npz", "uri": FLEET_FILE, **pose}
    builder.layer(name, "lidars", "recorded@1", LIDARS, [sweep])
    write_road_map(builder.layout.road_map("a") / MAP_FILE, replace(two_way_street(), scene_id="a"))
    map_bytes = (builder.layout.road_map("a") / MAP_FILE).read_bytes()
    seal(builder.layout.road_map("a"), {MAP_FILE: map_bytes}, derived_from={})
    vault = ("--vault", str(folder / "vault"), "--retain-days", "30")
    assert build(dataset, folder / "release", "--sample", "0", "--clock", "day", *vault) == 0
    return folder / "release"


@pytest.fixture
def release(released: Path, tmp_path: Path) -> Path:
    """A copy of the release."""
    return Path(shutil.copytree(released, tmp_path / "release"))


def rules(root: Path, **more: object) -> set[str]:
    return {one.rule_id for one in check_release(root, **more).findings}


def test_a_release_is_a_dataset_of_redacted_images_without_traces_of_the_originals(
    released: Path, deidentified: Path
) -> None:
    assert check_release(released, originals=deidentified, vault=released.parent / "vault").exit_code() == 0
    assert check(released, cost=2).exit_code() == 0
    dataset, source = mirror.open(str(released)), mirror.open(str(deidentified))
    assert dataset.count("images") == source.count("images") == 18
    rows = dataset.table("images").to_pylist()
    assert {row["privacy"] for row in rows} == {"redacted"} and {row["source_sha256"] for row in rows} == {None}
    shown = [
        {(image.read(verify=True), frame.frame_index, image.world_SE3_camera.translation.round(6).tobytes())
         for frame in view.frames() for image in frame.images.values()}
        for view in (source, dataset)
    ]  # fmt: skip
    assert shown[0] == shown[1] and len(shown[0]) == 18
    text = "".join(
        path.read_text(errors="replace")
        for path in released.rglob("*.*")
        if path.suffix in (".json", ".jsonl", ".md", ".txt", ".geojson")
    )
    for secret in ('"v0"', "d0.", "a.d1", str(released.parent)):
        assert secret not in text
    starts = [
        drive["start_ns"] for drive in map(json.loads, (p.read_text() for p in released.glob("drives/*/drive.json")))
    ]
    assert all(start % 86_400_000_000_000 < 1_000_000 for start in starts)
    assert [layer for _, _, layer in _layers(released)].count("depth/sweep@1") == 1
    # References to the files of a fleet stay behind.
    assert not list(released.rglob("lidars*"))
    assert not any(FLEET_FILE.encode() in path.read_bytes() for path in released.rglob("*") if path.is_file())
    said = (released / "DATASHEET.md").read_text()
    for sentence in ("begins at midnight UTC", "were not trimmed", "have pseudonyms of this release"):
        assert sentence in said
    assert "No image was reviewed by a person" in said
    # It was given to the de-identification.
    assert "Region of the number plates: XX." in said
    assert not (released / "maps").exists() and "road maps that were left out: 1." in said


def test_a_region_of_plates_that_contradicts_the_de_identification_is_refused(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--sample", "0", "--plate-region")
    assert build(dataset, tmp_path / "release", *words, "EU") == 2
    assert "--plate-region: EU, but the images were de-identified for number plates of XX" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dataset"]
    # A log of an earlier version does not record it: what the user states counts, and else it is not stated.
    for log in dataset.glob("traversals/*/layers/redaction/*/log.jsonl"):
        records = [one.model_copy(update={"plate_region": None}) for one in read_log(log)]
        log.write_bytes(encode_log(records))
    assert read_plate_regions(Layout(dataset), mirror.open(str(dataset)).traversals()) == {None}
    assert build(dataset, tmp_path / "release", *words, "eu") == 0
    assert "Region of the number plates: eu." in (tmp_path / "release" / "DATASHEET.md").read_text()


def _layers(root: Path) -> list[tuple[str, str, str]]:
    layout = Layout(root)
    names = mirror.open(str(root)).traversals()
    return [(name, "", f"{kind}/{source}@{version}") for name in names for kind, source, version in layout.layers(name)]


def plant_uncovered_face(root: Path) -> None:
    log = root / "redaction_log.jsonl"
    records = read_log(log)
    faces = [number for number, one in enumerate(records) if one.camera == "front_wide"]
    image = next(root.glob(f"traversals/{records[faces[0]].traversal_id}/recorded/front_wide/*.jpg"))
    write_image(image, marked(5, ((80, 10, 100, 40), RED)))


def plant_original(root: Path) -> None:
    dataset = root.parent / "dataset"
    target = sorted(root.glob("traversals/*/recorded/front_wide/*.jpg"))[0]
    shutil.copyfile(sorted(dataset.glob("traversals/a.d0.*/recorded/front_wide/*.jpg"))[0], target)


def plant_thumbnail(root: Path) -> None:
    _rewrite(root, lambda data, image: jpeg(image, thumbnail=True))


def plant_gps(root: Path) -> None:
    _rewrite(root, lambda data, image: jpeg(image, gps=True))


def plant_tail(root: Path) -> None:
    _rewrite(root, lambda data, image: data + jpeg(image))


def plant_sidecar(root: Path) -> None:
    (next(root.glob("traversals/*/recorded/rear")) / "preview.jpg").write_bytes(jpeg(marked(1, (FACE, RED))))


def plant_video(root: Path) -> None:
    (root / "rigs" / "drive.mp4").write_bytes(b"\0\0\0\x18ftypmp42")


def plant_model(root: Path) -> None:
    name = mirror.open(str(root)).traversals()[0]
    model = {"method": "m", "scene": "a", "split": "novel", "trained": {name: "0" * 64}}
    write_json(root / "model" / "reconstruction.json", {"format": "mirror-reconstruction", "version": "1", **model})


def plant_stale_layer(root: Path) -> None:
    folder = next(root.glob("traversals/*/layers/depth/sweep@1"))
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["derived_from"]["recorded"] = "f" * 64
    (folder / "manifest.json").write_text(json.dumps(manifest))


def plant_path(root: Path) -> None:
    path = next(root.glob("drives/*/drive.json"))
    path.write_text(path.read_text().replace('"time_base": "', '"time_base": "/home/anna/fleet '))


def plant_withdrawn(root: Path) -> None:
    release = read_json(root / "release.json", Release)
    name = mirror.open(str(root)).traversals()[0]
    tombstones = ({"item": name, "version": 1, "reason": ""},)
    write_json(root / "release.json", Release.model_validate({**release.model_dump(), "tombstones": tombstones}))


def plant_miss(root: Path) -> None:
    records = read_log(root / "redaction_log.jsonl")
    changed = [records[0].model_copy(update={"review": Review(verdict="miss", reviewer="b")}), *records[1:]]
    (root / "redaction_log.jsonl").write_bytes(encode_log(changed))


def plant_raw_image(root: Path) -> None:
    path = sorted(root.glob("traversals/*/recorded/images.parquet"))[0]
    rows = read_table(path, IMAGES).to_pylist()
    path.write_bytes(encode_rows([{**rows[0], "privacy": "raw"}, *rows[1:]], IMAGES))


def plant_redaction_layer(root: Path) -> None:
    dataset = root.parent / "dataset"
    source = next(dataset.glob("traversals/a.d0.*/layers/redaction"))
    shutil.copytree(source, next(root.glob("traversals/*")) / "layers" / "redaction")


def plant_fingerprint(root: Path) -> None:
    path = next(root.glob("drives/*/drive.json"))
    path.write_text(path.read_text().replace('"fingerprint": "' + "0" * 64, '"fingerprint": "' + "1" * 64))


def plant_broken_poses(root: Path) -> None:
    next(root.glob("traversals/*/recorded/ego_poses.parquet")).write_bytes(b"PAR1")


def _rewrite(root: Path, change: Callable[[bytes, np.ndarray], bytes]) -> None:
    path = sorted(root.glob("traversals/*/recorded/rear_left/*.jpg"))[0]
    data = path.read_bytes()
    path.write_bytes(change(data, np.asarray(Image.open(path))))


@pytest.mark.parametrize(
    ("plant", "rule"),
    [
        (plant_original, "REL013"),
        (plant_thumbnail, "REL003"),
        (plant_gps, "REL003"),
        (plant_tail, "REL003"),
        (plant_sidecar, "REL001"),
        (plant_video, "REL001"),
        (plant_model, "REL007"),
        (plant_stale_layer, "REL006"),
        (plant_raw_image, "REL004"),
        (plant_redaction_layer, "REL005"),
        (plant_fingerprint, "REL005"),
        (plant_broken_poses, "REL014"),
        (plant_path, "REL008"),
        (plant_withdrawn, "REL011"),
        (plant_miss, "REL009"),
        (lambda root: (root / "LICENCE.txt").unlink(), "REL010"),
        (lambda root: (root / "DATASHEET.md").write_text("nothing"), "REL010"),
        (lambda root: next(root.glob("traversals/*/recorded/rear/*.jpg")).unlink(), "REL002"),
        (lambda root: (root / "redaction_log.jsonl").write_bytes(b""), "REL002"),
    ],
)
def test_planted_faults_are_found(release: Path, released: Path, plant: Callable[[Path], None], rule: str) -> None:
    shutil.copytree(released.parent / "dataset" / "traversals", release.parent / "dataset" / "traversals")
    plant(release)
    found = check_release(release, vault=released.parent / "vault")
    assert rule in {one.rule_id for one in found.findings} and found.exit_code() == 1
    # Of these, the bytes differ from the log too.
    if plant in (plant_original, plant_thumbnail, plant_gps, plant_tail):
        assert "REL002" in {one.rule_id for one in found.findings}


def test_an_uncovered_face_is_found_by_a_detector(
    release: Path, released: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["release", "check", str(release), "--workers", "1", "--detector", "faces", "--detector", "plates"]
    assert main([*words, "--json"]) == 0
    plant_uncovered_face(release)
    capsys.readouterr()
    assert main([*words, "--json"]) == 1
    found = [one for one in json.loads(capsys.readouterr().out)["findings"] if one["rule_id"] == "REL012"]
    assert len(found) == 1 and "% covered" in found[0]["message"] and "front_wide" in found[0]["file"]


def test_a_release_needs_reviews_and_redacted_images(deidentified: Path, dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert build(dataset, out, "--sample", "5") == 1 and not out.exists()
    session = ReviewSession(dataset, "anna", 5)
    for number, record in enumerate(session.sample):
        session.say(record.out_sha256, "miss" if number == 4 else "ok")
    assert build(dataset, out, "--sample", "5") == 1 and not out.exists()
    session.say(session.sample[4].out_sha256, "false")
    assert build(dataset, out, "--sample", "5") == 0
    records = read_log(out / "redaction_log.jsonl")
    verdicts = {record.out_sha256: record.review.verdict for record in choose_sample(records, 5) if record.review}
    assert verdicts[session.sample[4].out_sha256] == "false" and set(verdicts.values()) <= {"false", "ok"}
    assert "at most 45.07 %" in (out / "DATASHEET.md").read_text()
    assert list(tmp_path.glob(".out*")) == []
    shutil.rmtree(next((dataset / "traversals").glob("a.d0.*/layers/redaction")))
    assert build(dataset, tmp_path / "other", "--sample", "0") == 2
    assert build(dataset, out, "--sample", "0") == 2
    assert build(dataset, dataset / "inside", "--sample", "0") == 2
    assert build(dataset, tmp_path / "x", "--sample", "0", "--vault", str(dataset / "vault")) == 2


def test_the_review_page_writes_only_what_its_own_page_sends(dataset: Path) -> None:
    session = ReviewSession(dataset, "anna", 3)
    server = review_server(session)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    base = f"http://127.0.0.1:{server.server_address[1]}"
    try:
        page = urllib.request.urlopen(f"{base}/?token={session.token}").read().decode()
        digest = session.sample[0].out_sha256
        assert digest in page and "http" not in page.replace("http://www.w3.org/2000/svg", "")
        assert urllib.request.urlopen(f"{base}/image/{digest}?token={session.token}").read()[:2] == b"\xff\xd8"
        good = {"token": session.token, "sha256": digest, "verdict": "ok"}
        for data, code in (
            ({**good, "token": "x"}, 403),
            ({**good, "sha256": "../../dataset.json"}, 404),
            ({**good, "verdict": "maybe"}, 400),
            ([], 400),
        ):
            with pytest.raises(urllib.error.HTTPError) as said:
                urllib.request.urlopen(urllib.request.Request(base, json.dumps(data).encode()))
            assert said.value.code == code
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(f"{base}/")
        assert session.done == 0
        urllib.request.urlopen(urllib.request.Request(base, json.dumps(good).encode()))
        assert session.reviews[digest].verdict == "ok"
        assert ReviewSession(dataset, "anna", 3).reviews[digest].verdict == "ok"
    finally:
        server.shutdown()
        server.server_close()


def test_withdrawals_make_a_new_version_with_tombstones(release: Path, tmp_path: Path) -> None:
    dataset = mirror.open(str(release))
    gone, kept = dataset.traversals()
    row = dataset.where(traversal=kept).table("images", ["camera", "timestamp_ns"]).to_pylist()[0]
    image = f"{kept}/{row['camera']}/{row['timestamp_ns']}"
    before = {path: path.read_bytes() for path in release.rglob("*") if path.is_file() and "index" not in path.parts}
    out = tmp_path / "next"
    assert main(["release", "withdraw", str(release), gone, image, "--out", str(out), "--reason", "request 7"]) == 0
    assert all(path.read_bytes() == data for path, data in before.items())
    document = read_json(out / "release.json", Release)
    assert document.version == 2 and [one.item for one in document.tombstones] == sorted([gone, image])
    assert check_release(out).exit_code() == 0 and check(out, cost=2).exit_code() == 0
    after = mirror.open(str(out))
    assert after.traversals() == [kept] and after.count("images") == 8
    assert not (out / f"traversals/{image.replace(kept, f'{kept}/recorded')}.jpg").exists()
    assert "request 7" in (out / "DATASHEET.md").read_text()
    assert main(["release", "withdraw", str(release), "nothing", "--out", str(tmp_path / "x")]) == 2
    assert not (tmp_path / "x").exists()


def test_the_ends_of_drives_are_trimmed(dataset: Path, tmp_path: Path) -> None:
    # The only traversal of each drive begins with the drive.
    assert build(dataset, tmp_path / "out", "--sample", "0", "--trim-ends-s", "60") == 2
    assert not (tmp_path / "out").exists() and list(tmp_path.glob(".out*")) == []


def test_one_key_gives_the_same_pseudonyms(dataset: Path, tmp_path: Path) -> None:
    names = []
    for number, vault in enumerate(("one", "one", "two")):
        out = tmp_path / str(number)
        assert build(dataset, out, "--sample", "0", "--vault", str(tmp_path / vault)) == 0
        names.append(mirror.open(str(out)).traversals())
    assert names[0] == names[1] != names[2]
    assert complete_manifest(segment_folder(tmp_path / "0")) is not None


def test_a_vault_that_is_kept_too_long_is_found(released: Path, tmp_path: Path) -> None:
    vault = Path(shutil.copytree(released.parent / "vault", tmp_path / "vault"))
    today = datetime.datetime.now(datetime.UTC).date()
    kept = read_json(vault / "vault.json", Vault)
    assert kept.retain_until in {(today + datetime.timedelta(days=days)).isoformat() for days in (29, 30)}
    assert rules(released, vault=vault) == set()
    write_json(vault / "vault.json", kept.model_copy(update={"retain_until": "2020-02-29"}))
    assert rules(released, vault=vault) == {"REL015"}


@pytest.mark.parametrize(
    ("misses", "images", "bound"), [(0, 300, 0.009936), (0, 1, 0.95), (3, 100, 0.0757), (5, 5, 1.0), (0, 0, 1.0)]
)
def test_the_bound_is_that_of_clopper_and_pearson(misses: int, images: int, bound: float) -> None:
    assert miss_bound(misses, images) == pytest.approx(bound, abs=1e-4)


def test_what_is_no_release_could_not_be_checked(tmp_path: Path, dataset: Path) -> None:
    for root in (tmp_path / "none", dataset):
        assert main(["release", "check", str(root)]) == 2


def test_a_preview_in_a_model_and_a_page_with_an_original_are_found(released: Path, tmp_path: Path) -> None:
    dataset = released.parent / "dataset"
    original = next(iter(sorted(dataset.glob("traversals/*/recorded/front_wide/*.jpg")))).read_bytes()
    model = tmp_path / "model"
    model.mkdir()
    (model / "weights.safetensors").write_bytes(bytes(100) + original)
    (model / "page.html").write_text(f'<img src="data:image/jpeg;base64,{base64.b64encode(original).decode()}">')
    (model / "preview.png").write_bytes(cv2.imencode(".png", cv2.imdecode(np.frombuffer(original, np.uint8), 1))[1])
    source = Layout(dataset)
    assert not find_leaving(source, [released], NullProgress())
    found = find_leaving(source, [released, model], NullProgress())
    assert {one.file for one in found} == {str(path) for path in model.iterdir()}
    assert {one.rule_id for one in found} == {"REL017"}


def test_a_photo_saved_as_a_mask_does_not_reach_a_release(dataset: Path, tmp_path: Path) -> None:
    photo = np.asarray(Image.fromarray(marked(4, (FACE, RED))).convert("L"))
    for path in dataset.glob("rigs/*.json"):
        document = json.loads(path.read_text())
        for camera in document["cameras"]:
            camera["static_mask"] = f"{path.stem}.{camera['name']}.png"
            write_image(path.parent / camera["static_mask"], np.repeat(photo[..., None], 3, axis=2))
        path.write_text(json.dumps(document))
    # A layer of masks whose rows name the photo, too.
    name = next((dataset / "traversals").iterdir()).name
    stamp = read_table(Layout(dataset).recorded(name) / "images.parquet", IMAGES).column("timestamp_ns")[0].as_py()
    writer = LayerWriter(Layout(dataset), name, "masks", "people", "1")
    row = {"camera": "front_wide", "timestamp_ns": stamp, "kind": "instance"}
    writer.finish(MASKS, [{**row, **writer.file("a.png", encoded_png(photo))}], {})
    assert build(dataset, tmp_path / "release", "--sample", "0") == 0
    release = tmp_path / "release"
    masks = [*release.glob("rigs/*.png"), *release.glob("traversals/*/layers/masks/**/*.png")]
    assert len(masks) > 4
    for path in masks:
        assert set(np.unique(np.asarray(Image.open(path)))) <= {0, 255}, path
    assert check_release(tmp_path / "release").exit_code() == 0
    write_image(next((tmp_path / "release" / "rigs").glob("*.png")), np.repeat(photo[..., None], 3, axis=2))
    assert "REL018" in rules(tmp_path / "release")


def encoded_png(pixels: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()
