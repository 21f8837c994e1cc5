"""Take-downs: what loses an image, what stays byte for byte, and who is refused afterwards."""

from __future__ import annotations

import hashlib
import json
import shutil
import tarfile
from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.dataset.destination import FolderDestination
from mirror.dataset.layout import Layout
from mirror.dataset.lease import hold_lease
from mirror.dataset.splits import make_split
from mirror.dataset.take_down import take_down
from mirror.errors import DatasetError, UsageError
from mirror.export.audit import audit
from mirror.export.fetch import fetch
from mirror.export.publish import PublishOptions, PublishReport, publish
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from mirror.integrity import Cost, check
from mirror.schema.bundle import PUBLISHING, Bundle
from mirror.schema.documents import NovelTraversal
from mirror.schema.files import read_json, read_table
from mirror.schema.tables import IMAGES
from tests.builders.folder import SCENE, START_NS, tree, write_recording
from tests.builders.shards import rewrite_images
from tests.evaluation.submissions import SPLIT
from tests.export.leaving import CAMERAS, copied, redact, sealed
from tests.interruption import kill_command_before

Key = tuple[str, str, int]
REASON = "request 7"


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two drives along a street, of three cameras, whose images differ from each other."""
    folder = tmp_path_factory.mktemp("fleet")
    starts = [START_NS, START_NS + 10**13]
    return [
        write_recording(folder, f"d{number}", start_ns=start_ns, speed_mps=11.5, cameras=CAMERAS, seed=number)
        for number, start_ns in enumerate(starts)
    ]


def write_street(recordings: list[Path], root: Path, *, shards: bool) -> Dataset:
    options = IngestOptions(workers=1, write=WriteOptions(shards=shards))
    assert not ingest_recordings(recordings, [SCENE], root, options).failures
    make_split(root, SPLIT, NovelTraversal(train=1, held_out=1))
    return mirror.open(root)


@pytest.fixture(scope="module")
def sharded(recordings: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two traversals whose images lie in shards, without a redaction."""
    return write_street(recordings, tmp_path_factory.mktemp("sharded") / "dataset", shards=True)


@pytest.fixture(scope="module")
def redacted_street(sharded: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The same with a redaction layer in shards, and a publication beside it."""
    root = copied(sharded, tmp_path_factory.mktemp("redacted") / "dataset")
    redact(root, shards=True)
    sealed(published(root, root.parent / "published"))
    return mirror.open(root)


@pytest.fixture
def root(redacted_street: Dataset, tmp_path: Path) -> Path:
    shutil.copytree(Path(str(redacted_street.root)).parent / "published", tmp_path / "published")
    return copied(redacted_street, tmp_path / "dataset")


def published(root: Path, out: Path) -> PublishReport:
    return publish(root, str(out), PublishOptions(split=SPLIT, protocols=(), name="Street", licence="CC0-1.0"))


def train(root: Path) -> str:
    roles = json.loads((root / "splits" / f"{SPLIT}.json").read_text())["assignments"]
    return next(name for name, role in roles.items() if role == "train")


def image_of(root: Path, camera: str = "front_left", number: int = 2) -> Key:
    traversal_id = train(root)
    rows = mirror.open(root).where(traversal=traversal_id, camera=camera).table("images").to_pylist()
    return traversal_id, camera, rows[number]["timestamp_ns"]


def name_of(key: Key) -> str:
    return "/".join(map(str, key))


def bytes_of(root: Path, key: Key) -> dict[str, bytes]:
    """The bytes of an image, as they were recorded and as they were redacted."""
    layout, found = Layout(root), {}
    folders = {"recorded": layout.recorded(key[0]), "redacted": layout.layer(key[0], "redaction", "corner", "1")}
    for name, folder in folders.items():
        if not folder.exists():
            continue
        for row in read_table(folder / "images.parquet", IMAGES).to_pylist():
            if (row["camera"], row["timestamp_ns"]) == key[1:]:
                data = (root / row["uri"]).read_bytes()
                found[name] = data[row["byte_offset"] :][: row["byte_length"]]
                assert hashlib.sha256(found[name]).digest() == row["sha256"]
    return found


def holders(root: Path, data: bytes) -> set[str]:
    """The files that hold some bytes."""
    return {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file() and data in path.read_bytes()}


def found_by_check(root: Path) -> set[str]:
    return {rule.rule_id for rule, _ in check(root, cost=Cost.IMAGES).findings}


def words(root: Path, key: Key, *more: str) -> list[str]:
    named = ["--image", name_of(key), "--reason", REASON, "--publication", str(root.parent / "published")]
    return ["dataset", "take-down", str(root), *named, *more]


def test_an_image_goes_from_shards_of_redactions_and_publications_and_nothing_else_changes(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    key, out = image_of(root), tmp_path / "published"
    data, before, outside, findings = bytes_of(root, key), tree(root), tree(out), found_by_check(root)
    rows = mirror.open(root).table("images").to_pylist()
    assert main(words(root, key, "--dry-run", "--json")) == 0
    planned = json.loads(capsys.readouterr().out)
    archive = f"traversals/{key[0]}/layers/redaction/corner@1/images-00000.tar"
    assert planned["purged"] == [archive] and planned["publications"][0]["images"] == 1
    assert tree(root) == before and tree(out) == outside

    assert main(words(root, key, "--json")) == 0
    done = json.loads(capsys.readouterr().out)
    assert {**done, "dry_run": True, "publications": []} == {**planned, "publications": []}
    assert (done["images"], done["new"], done["snapshots"]) == (1, 1, [1, 2])
    assert done["originals"] == [f"traversals/{key[0]}/recorded/images-00000.tar"]
    assert not holders(tmp_path, data["redacted"])
    assert holders(tmp_path, data["recorded"]) == {f"dataset/{done['originals'][0]}"}

    # Of the dataset one archive changed, and in it the place of one image; tables, manifests and splits stay.
    after = tree(root)
    changed = {name for name in before if after.get(name) != before[name] and not name.startswith("index/")}
    assert changed == {archive}
    assert {name for name in after if name not in before and not name.startswith("index/")} == {"take_downs.json"}
    with tarfile.open(root / archive) as opened:
        files = {member.name: opened.extractfile(member) for member in opened}
        held = {name: file.read() for name, file in files.items() if file is not None}
    assert {name for name, content in held.items() if not any(content)} == {f"{key[1]}/{key[2]}.jpg"}
    dataset = mirror.open(root)
    assert dataset.table("images").to_pylist() == [
        row for row in rows if (row["traversal_id"], row["camera"], row["timestamp_ns"]) != key
    ]
    read = [image.read(verify=True) for frame in dataset.frames() for image in frame.images.values()]
    assert len(read) == len(rows) - 1

    # Who asks for a snapshot that had the image gets the reason.
    for number in (1, 2):
        with pytest.raises(
            DatasetError, match=rf"snapshot {number} has lost rows: .*{key[2]} was taken down \({REASON}"
        ):
            mirror.open(root, at=number)
    assert mirror.open(root, at=3).snapshot == 3

    # The publication is what publishing again would write, and no reason is in it.
    again = sealed(published(root, tmp_path / "again"))
    assert read_json(out / "bundle.json", Bundle) == again
    assert not holders(out, REASON.encode()) and not (out / PUBLISHING).exists()
    assert tree(out) == tree(tmp_path / "again")
    assert audit(str(out), root).exit_code() == 0
    assert not fetch(str(out), tmp_path / "fetched").failed
    assert mirror.open(out).count("images") == len(rows) - 1

    # Once more: nothing changes.
    states = tree(root), tree(out)
    assert main(words(root, key, "--json")) == 0
    repeated = json.loads(capsys.readouterr().out)
    assert (repeated["new"], repeated["purged"], repeated["publications"][0]["purged"]) == (0, [], [])
    assert (tree(root), tree(out)) == states

    # The originals go on request alone, and the tables of the recording stay.
    assert main(words(root, key, "--purge-originals")) == 0
    assert not holders(tmp_path, data["recorded"])
    last = tree(root)
    assert {name for name in last if last[name] != states[0].get(name)} == set(done["originals"])
    assert found_by_check(root) == findings


def test_an_image_that_was_taken_down_is_found_in_shards_that_are_out_and_refused(
    root: Path, sharded: Dataset, tmp_path: Path
) -> None:
    key, out = image_of(root), tmp_path / "published"
    take_down(root, [key], purge_originals=True)
    # Its bytes are nowhere in the dataset any more: hashes find it, by member of the archive.
    leaks = audit(str(out), root).leaks
    archive = f"traversals/{key[0]}/layers/redaction/corner@1/images-00000.tar"
    said = f"member {key[1]}/{key[2]}.jpg has the bytes of an image that was taken down: {name_of(key)}"
    assert (archive, said) in leaks
    # Without a redaction the recorded shard would leave, with the image in it.
    raw = copied(sharded, tmp_path / "raw")
    take_down(raw, [key])
    with pytest.raises(DatasetError, match=r"shows an image that was taken down.*--purge-originals"):
        published(raw, tmp_path / "refused")
    assert not (tmp_path / "refused" / "bundle.json").exists()
    data = bytes_of(raw, key)["recorded"]
    take_down(raw, [key], purge_originals=True)
    sealed(published(raw, tmp_path / "refused"))
    assert not holders(tmp_path / "refused", data)
    # A file that somebody puts into a publication is found too.
    (tmp_path / "refused" / "copy.bin").write_bytes(b"some bytes before " + data)
    with tarfile.open(tmp_path / "refused" / "more.tar", "w") as opened:
        (tmp_path / "image").write_bytes(data)
        opened.add(tmp_path / "image", "any name")
    found = {one.file for one in audit(str(tmp_path / "refused"), raw).leaks}
    assert "more.tar" in found


def test_a_take_down_that_is_killed_at_any_instant_is_finished_by_the_same_command(root: Path, tmp_path: Path) -> None:
    key, whole = image_of(root), tmp_path / "whole"
    whole.mkdir()
    shutil.copytree(root, whole / "dataset")
    shutil.copytree(tmp_path / "published", whole / "published")
    assert main(words(whole / "dataset", key, "--purge-originals")) == 0
    command = words(root, key, "--purge-originals")
    # Each run goes on where the one before was killed; the last of the names that it gives comes later each time.
    for pattern, count in (
        ("dataset/take_downs.json", 1),
        ("dataset/index/*/manifest.json", 1),
        ("dataset/index/snapshots/*.json", 1),
        ("dataset/take_downs.json", 1),
        ("redaction/corner@1/images-00000.tar", 1),
        ("dataset/traversals/*/recorded/images-00000.tar", 1),
        ("published/take_downs.json", 1),
        ("published/traversals/*/layers/redaction/corner@1/images-00000.tar", 1),
        ("published/index/snapshots/*.json", 1),
        ("published/croissant.json", 1),
        ("published/bundle.json", 1),
    ):
        kill_command_before(pattern, count, command)
    assert main(command) == 0
    assert tree(root) == tree(whole / "dataset") and tree(tmp_path / "published") == tree(whole / "published")
    # The unfinished name of a snapshot, which has no image, stays for a day: another run may be putting it.
    left = [path for folder in (root, tmp_path / "published") for path in folder.rglob(".*")]
    assert {path.parent.name for path in left} <= {"snapshots"}


def test_a_reference_image_as_a_file_goes_and_its_frame_keeps_number_and_other_images(
    recordings: list[Path], tmp_path: Path
) -> None:
    root = tmp_path / "dataset"
    write_street(recordings, root, shards=False)
    redact(root)
    key = image_of(root, "front_wide")
    # The first snapshot is from before the second drive: it has no row of the other one's images.
    before, findings = mirror.open(root).frames(), found_by_check(root)
    listed = tmp_path / "list.txt"
    listed.write_text(f"# those of request 7\n\n{name_of(key)}\n")
    assert main(["dataset", "take-down", str(root), "--list", str(listed), "--purge-originals"]) == 0
    gone = [path for path in root.rglob(f"{key[2]}.jpg") if path.parent.name == key[1] and key[0] in path.parts]
    assert gone == []
    after = mirror.open(root).frames()
    assert [(one.traversal_id, one.frame_index, one.timestamp_ns) for one in after] == [
        (one.traversal_id, one.frame_index, one.timestamp_ns) for one in before
    ]
    fewer = [one for one, other in zip(after, before) if set(one.images) != set(other.images)]
    assert [(one.traversal_id, one.timestamp_ns, sorted(one.images)) for one in fewer] == [
        (key[0], key[2], ["front_left", "rear"])
    ]
    assert found_by_check(root) - findings <= {"TIM006", "TIM005"}
    assert not check(root, cost=Cost.IMAGES).counts()["error"]
    # Images without bytes are not in the way of a publication.
    sealed(published(root, tmp_path / "published"))


def test_wrong_calls_are_refused_and_change_nothing(root: Path, tmp_path: Path) -> None:
    key, before = image_of(root), tree(root)
    for images, said in (([], "no image is named"), ([(key[0], "rear", 5)], f"no image {key[0]}/rear/5")):
        with pytest.raises(UsageError, match=said):
            take_down(root, images)
    with pytest.raises(UsageError, match="a published dataset"):
        take_down(tmp_path / "published", [key])
    for more in (["--publication", str(root)], ["--image", "rear/5"], ["--list", str(root)], ["--list", "missing"]):
        assert main(["dataset", "take-down", str(root), "--image", name_of(key), *more]) == 2
    with hold_lease(FolderDestination(root), "gc"), pytest.raises(DatasetError, match="for gc, since"):
        take_down(root, [key])
    assert tree(root) == before


def test_snapshots_from_before_a_drive_stay(sharded: Dataset, tmp_path: Path) -> None:
    root = copied(sharded, tmp_path / "dataset")
    other = next(name for name in sharded.traversals() if name != train(root))
    rows = sharded.where(traversal=other).table("images", ["camera", "timestamp_ns"]).to_pylist()
    # As if the second drive had been added later: a snapshot that names the first one alone.
    first = json.loads((root / "index/snapshots/00000001.json").read_text())
    assert {drive for one in first["segments"] for drive in one["drives"]} == set(sharded.drives())
    kept = sharded.where(traversal=train(root)).drives()
    early = {**first, "segments": [{**one, "drives": kept, "is_whole": False} for one in first["segments"]]}
    (root / "index/snapshots/00000001.json").write_text(json.dumps(early))
    (root / "index/snapshots/00000002.json").write_text(json.dumps(first))
    report = take_down(root, [(other, rows[0]["camera"], rows[0]["timestamp_ns"])])
    assert report.snapshots == (2,)
    assert mirror.open(root, at=1).traversals() == [train(root)]
    with pytest.raises(DatasetError, match="no reason is stated"):
        mirror.open(root, at=2)


def test_a_publication_refuses_addresses_of_a_fleets_own_store(root: Path, tmp_path: Path) -> None:
    def refer(images: pa.Table, folder: str) -> pa.Table:
        uris = [f"s3://fleet-own-store/{uri}" for uri in images.column("uri").to_pylist()]
        return images.set_column(images.column_names.index("uri"), images.schema.field("uri"), pa.array(uris))

    # The redacted images lie in the dataset; its tables name the originals in a store of the fleet.
    rewrite_images(Layout(root), refer)
    with pytest.raises(DatasetError, match=r"s3://fleet-own-store/.* lies outside of the dataset"):
        published(root, tmp_path / "out")
    assert not holders(tmp_path / "out", b"fleet-own-store") if (tmp_path / "out").exists() else True


@pytest.fixture(autouse=True)
def cwd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Run in an empty folder: a list that is missing is missing."""
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    yield
