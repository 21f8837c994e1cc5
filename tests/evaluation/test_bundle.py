"""Published datasets: without held-out images, fetched over HTTP, and good for submissions to the complete dataset."""

from __future__ import annotations

import hashlib
import json
import re
import resource
import shutil
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, SchemaError, UsageError
from mirror.evaluation.run import EvaluationOptions, evaluate
from mirror.evaluation.submission.manifest import Appearance, SubmittedMethod
from mirror.evaluation.submission.template import make_manifest, write_manifest
from mirror.export.fetch import fetch
from mirror.export.publish import PublishOptions, PublishReport, publish
from mirror.protocols.png import encode_png
from mirror.protocols.views import plan_views
from mirror.schema.bundle import PUBLISHING, Bundle
from tests.conftest import ROOT
from tests.evaluation.submissions import SPLIT, small, write_renders
from tests.interruption import InterruptingProgress

BROKEN: set[str] = set()
REQUESTED: list[str] = []


class _Handler(SimpleHTTPRequestHandler):
    def do_GET(self) -> None:
        REQUESTED.append(self.path.lstrip("/"))
        if self.path.lstrip("/") in BROKEN:
            self.send_error(503)
        else:
            super().do_GET()

    def log_message(self, *arguments: object) -> None:
        pass


def options(**changes: object) -> PublishOptions:
    return PublishOptions(
        **{"split": SPLIT, "protocols": (small(),), "name": "Street", "licence": "CC0-1.0", **changes}
    )


def published(report: PublishReport) -> Bundle:
    """The document of a bundle that was sealed."""
    assert report.bundle is not None, report.leaks
    return report.bundle


@pytest.fixture(scope="module")
def bundle(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("published") / "bundle"
    publish(root, str(out), options())
    return out


@pytest.fixture
def url(bundle: Path) -> Iterator[str]:
    pytest.importorskip("aiohttp", reason="the extra http is not installed")
    BROKEN.clear(), REQUESTED.clear()
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Handler, directory=str(bundle)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


def test_published_bundle_has_everything_but_held_out_images(dataset: Dataset, root: Path, bundle: Path) -> None:
    document = Bundle.model_validate_json((bundle / "bundle.json").read_bytes())
    held_out = {
        row["traversal_id"] for row in dataset.where(split=SPLIT, role="held_out").table("traversals").to_pylist()
    }
    images = dataset.table("images", ["traversal_id", "camera", "timestamp_ns", "uri"]).to_pylist()
    scored = {(view.traversal_id, view.camera, view.timestamp_ns) for view in plan_views(dataset, small(), SPLIT).views}
    assert held_out and scored
    withheld = {row["uri"] for row in images if row["traversal_id"] in held_out}
    assert {
        row["uri"] for row in images if (row["traversal_id"], row["camera"], row["timestamp_ns"]) in scored
    } <= withheld
    assert set(document.withheld) == withheld
    for row in images:
        published = bundle / row["uri"]
        assert published.exists() == (row["uri"] not in withheld)
        if published.exists():
            assert published.read_bytes() == (root / row["uri"]).read_bytes()
    for name, entry in document.files.items():
        data = (bundle / name).read_bytes()
        assert (len(data), hashlib.sha256(data).hexdigest()) == (entry.bytes, entry.sha256), name
    assert {str(path.relative_to(bundle)) for path in bundle.rglob("*") if path.is_file()} - {".lock"} == {
        *document.files, "bundle.json"
    }  # fmt: skip
    sheet = (bundle / "README.md").read_text()
    samples = dict(re.findall(r"!\[([^]]*)\]\(<([^>]*)>\)", sheet))
    listed = json.loads((bundle / "bundle.json").read_text())["files"]
    # One image of each condition, which is a file of the bundle.
    assert samples and set(samples.values()) <= set(listed) and not set(samples.values()) & withheld
    lights = {
        row["traversal_id"]: f"{row['light']}, {row['weather']}" for row in dataset.table("traversals").to_pylist()
    }
    assert all(lights[path.split("/")[1]] == words for words, path in samples.items())
    assert (
        sheet.startswith("---\npretty_name: Street\nlicense: cc0-1.0\n")
        and f"{len(withheld):,} images are withheld" in sheet
    )
    assert "CC0-1.0" in (bundle / "LICENSE").read_text()


def test_check_does_not_miss_withheld_images(bundle: Path, root: Path, tmp_path: Path) -> None:
    def missing(folder: Path) -> int:
        return sum(rule.rule_id == "IMG001" for rule, _ in mirror.check(folder).findings)

    assert missing(bundle) == missing(root) == 0
    fetch(str(bundle), tmp_path / "d")
    published = next((tmp_path / "d" / "traversals").rglob("*.jpg"))
    published.unlink()
    assert missing(tmp_path / "d") == 1


def test_images_that_a_protocol_scores_in_training_traversals_are_withheld(
    root: Path, dataset: Dataset, tmp_path: Path
) -> None:
    training = small(groups='[[groups]]\nname = "training"\nroles = ["train"]\n')
    scored = {view.timestamp_ns for view in plan_views(dataset, training, SPLIT).views}
    document = published(publish(root, str(tmp_path / "b"), options(protocols=(small(), training))))
    names = {path.rpartition("/")[2].partition(".")[0] for path in document.withheld}
    assert scored and {str(stamp) for stamp in scored} <= names
    assert "those scored by `small`, `small`." in (tmp_path / "b" / "README.md").read_text()


def test_fetched_dataset_asks_for_the_same_views(dataset: Dataset, url: str, tmp_path: Path) -> None:
    assert main(["dataset", "fetch", url, "--out", str(tmp_path / "d"), "--json"]) == 0
    fetched = mirror.open(tmp_path / "d")
    assert plan_views(fetched, small(), SPLIT).hash == plan_views(dataset, small(), SPLIT).hash
    training = fetched.where(split=SPLIT, role="train")
    assert next(iter(training.frames())).images["front_wide"].decode().shape[2] == 3
    held_out = next(iter(fetched.where(split=SPLIT, role="held_out").frames()))
    with pytest.raises(DatasetError, match="only its organiser has this image"):
        held_out.images["front_wide"].decode()


def test_a_participant_cannot_score(dataset: Dataset, bundle: Path, tmp_path: Path) -> None:
    few = small(every=12)
    write_renders(dataset, few, tmp_path / "s")
    with pytest.raises(DatasetError, match="lacks the images"):
        evaluate(tmp_path / "s", bundle, few, SPLIT, tmp_path / "out", EvaluationOptions(workers=1))


def test_fetch_continues_after_failures_and_verifies_bytes(
    bundle: Path, url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "d"
    document = Bundle.model_validate_json((bundle / "bundle.json").read_bytes())
    broken = next(name for name in document.files if name.endswith(".jpg"))
    BROKEN.add(broken)
    assert main(["dataset", "fetch", url, "--out", str(out), "--json"]) == 3
    said = capsys.readouterr()
    assert json.loads(said.out)["failed"] == [broken] and broken in said.err
    assert not (out / "dataset.json").exists() and not list(out.rglob("*.tmp"))
    # A file that was damaged on disk since, and the one that failed, are fetched; all others are kept.
    damaged = next(name for name in document.files if name.endswith(".parquet"))
    (out / damaged).write_bytes(b"x" * document.files[damaged].bytes)
    BROKEN.clear(), REQUESTED.clear()
    report = fetch(url, out)
    assert not report.failed and report.fetched == 3
    assert sorted(REQUESTED) == sorted(["bundle.json", broken, damaged, "dataset.json"])
    assert fetch(url, out).kept == len(document.files)


def test_bytes_that_differ_from_the_hash_are_refused(bundle: Path, tmp_path: Path) -> None:
    source = tmp_path / "source"
    for path in bundle.rglob("*"):
        if path.is_file():
            target = source / path.relative_to(bundle)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(path.read_bytes())
    (source / "rois.geojson").write_text("{}")
    report = fetch(str(source), tmp_path / "d")
    assert [name for name, _ in report.failed] == ["rois.geojson"] and "differ from the hash" in report.failed[0][1]
    assert not (tmp_path / "d" / "rois.geojson").exists()
    for path in ("../escape", "/etc/passwd", "a/../../b"):
        document = json.loads((bundle / "bundle.json").read_bytes())
        document["files"][path] = {"bytes": 1, "sha256": "0" * 64}
        (source / "bundle.json").write_text(json.dumps(document))
        with pytest.raises(SchemaError, match="leads out of its folder"):
            fetch(str(source), tmp_path / "e")


def test_an_interrupted_call_continues_and_a_stricter_one_removes(root: Path, tmp_path: Path) -> None:
    out = tmp_path / "bundle"
    with pytest.raises(KeyboardInterrupt):
        publish(root, str(out), options(protocols=()), progress=InterruptingProgress(1))
    assert not (out / "bundle.json").exists()
    # A killed process leaves its unfinished files, also beside the folders of the dataset.
    killed = [out / f".{name}.12345.tmp" for name in ("dataset.json", "README.md")]
    for file in killed:
        file.write_bytes(b"half of")
    loose = published(publish(root, str(out), options(protocols=())))
    assert not (out / PUBLISHING).exists()
    assert not [file for file in killed if file.exists()]
    (out / ".git").mkdir()
    (out / ".git" / "config").write_text("a repository of the host")
    training = small(groups='[[groups]]\nname = "training"\nroles = ["train"]\n')
    strict = published(publish(root, str(out), options(protocols=(training,))))
    assert (out / ".git" / "config").exists()
    assert set(strict.withheld) > set(loose.withheld)
    assert not [name for name in strict.withheld if (out / name).exists()]
    assert set(strict.files) < set(loose.files)
    for name, entry in strict.files.items():
        assert hashlib.sha256((out / name).read_bytes()).hexdigest() == entry.sha256


def test_refusals(root: Path, bundle: Path, tmp_path: Path) -> None:
    unlicensed = shutil.copytree(root, tmp_path / "unlicensed")
    document = json.loads((root / "dataset.json").read_bytes())
    (unlicensed / "dataset.json").write_text(json.dumps({**document, "licence": None}))
    with pytest.raises(UsageError, match="states no licence"):
        publish(unlicensed, str(tmp_path / "b"), options(licence=None))
    with pytest.raises(UsageError, match="it is a dataset"):
        publish(root, str(root), options())
    with pytest.raises(DatasetError, match=f"no such split; expected one of .*{SPLIT}"):
        publish(root, str(tmp_path / "b"), options(split="none"))
    with pytest.raises(DatasetError, match="missing"):
        fetch(str(root), tmp_path / "d")
    with pytest.raises(DatasetError, match="missing"):
        fetch(str(bundle / "bundle.json"), tmp_path / "d")
    with pytest.raises(UsageError, match="it is a dataset"):
        fetch(str(bundle), root)
    fetch(str(bundle), tmp_path / "d")
    other = json.loads((bundle / "bundle.json").read_bytes()) | {"licence": "another"}
    (tmp_path / "d" / "bundle.json").write_text(json.dumps(other))
    with pytest.raises(DatasetError, match="another bundle"):
        fetch(str(bundle), tmp_path / "d")
    assert main(["ingest", str(tmp_path), "--roi", "1,2", "--out", str(bundle)]) == 2


def test_a_bundle_is_published_to_a_url(root: Path, tmp_path: Path) -> None:
    document = published(publish(root, "memory://published/street", options()))
    report = fetch("memory://published/street", tmp_path / "d")
    assert report.fetched == len(document.files) and not report.failed


def test_a_published_bundle_is_trained_on_and_its_submission_is_scored(
    root: Path, dataset: Dataset, tmp_path: Path
) -> None:
    """Publish, fetch, train one epoch, render, check, and evaluate against the complete dataset."""
    torch = pytest.importorskip("torch")
    from torch.utils.data import DataLoader

    from mirror.dataset.torch import FrameDataset, IterableFrames

    both = small(groups='[[groups]]\nname = "all"\nroles = ["held_out", "train"]\n')
    document = published(publish(root, str(tmp_path / "b"), options(protocols=(both,))))
    fetch(str(tmp_path / "b"), tmp_path / "d")
    fetched = mirror.open(tmp_path / "d")
    training = fetched.where(split=SPLIT, role="train", camera=["front_wide", "front_left"])
    images = training.table("images", ["uri", "frame_index"]).to_pylist()
    withheld = [row for row in images if row["uri"] in document.withheld]
    assert 0 < len(withheld) < len(images)
    assert training.where(withheld=True).count("images") == len(withheld)
    assert training.where(withheld=False).count("images") == len(images) - len(withheld)
    assert fetched.where(withheld=True).count("images") == len(document.withheld)
    assert dataset.where(withheld=True).count("images") == dataset.where(withheld=True).count("frames") == 0
    assert dataset.where(withheld=False).count("frames") == dataset.count("frames")
    lacking = {row["frame_index"] for row in withheld} - {None}
    complete = training.where(withheld=False)
    assert {frame.frame_index for frame in complete.frames()}.isdisjoint(lacking)
    assert complete.count("frames") == training.count("frames") - len(lacking)
    assert not len(complete.where(withheld=True).frames())
    assert FrameDataset(complete, boxes=False)[0]["valid"].all()
    model = torch.nn.Conv2d(3, 3, kernel_size=3, padding=1)
    optimiser = torch.optim.Adam(model.parameters())
    frames, total = IterableFrames(training, 2, resize=(48, 64), boxes=False, masks=[]), 0
    for batch in DataLoader(frames, batch_size=None):
        total += int(batch["valid"].sum())
        pixels = batch["images"].flatten(0, 1).float() / 255.0
        counts = (batch["pixel_valid"] & batch["valid"][..., None, None]).flatten(0, 1)
        assert not pixels[~batch["valid"].flatten()].any()
        loss = ((model(pixels) - pixels) ** 2).mean(dim=1)[counts].mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert total == sum(row["frame_index"] is not None for row in images) - len(withheld)
    assert torch.isfinite(loss)
    few = small(every=12)
    plan = plan_views(fetched, few, SPLIT)
    out = tmp_path / "submission"
    for view in plan.views:
        with torch.no_grad():
            grey = model(torch.full((1, 3, view.height_px, view.width_px), 0.5))[0].clamp(0, 1)
        (out / view.path).parent.mkdir(parents=True, exist_ok=True)
        (out / view.path).write_bytes(encode_png((grey.permute(1, 2, 0).numpy() * 255).astype("uint8")))
    write_manifest(out, make_manifest(plan, SubmittedMethod(name="one layer"), Appearance(policy="none"), None))
    result = evaluate(out, root, few, SPLIT, tmp_path / "results", EvaluationOptions(workers=1)).result
    assert {figure.metric for figure in result.figures} >= {"psnr", "ssim"}


def test_the_loop_of_the_page_survives_batches_whose_images_are_all_withheld(root: Path, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    published(publish(root, str(tmp_path / "b"), options(protocols=(mirror.load_protocol("static-reconstruction"),))))
    fetch(str(tmp_path / "b"), tmp_path / "d")
    page = (ROOT / "docs" / "loading.md").read_text()
    (code,) = [block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "optimiser.step" in block]
    for withheld in (True, False):
        names: dict[str, Any] = {"dataset": mirror.open(tmp_path / "d").where(withheld=withheld)}
        exec(code, names)
        assert bool(names["batch"]["valid"].any()) is not withheld
        assert torch.isfinite(names["loss"])
        assert all(torch.isfinite(values).all() for values in names["model"].parameters())


class _Endless(SimpleHTTPRequestHandler):
    """Answers one path with a body that does not end, without a length."""

    endless = "bundle.json"
    sent = 0

    def do_GET(self) -> None:
        if self.path.lstrip("/") != type(self).endless:
            super().do_GET()
            return
        self.send_response(200)
        self.end_headers()
        block = b" " * (1 << 20)
        try:
            while type(self).sent < 4 << 30:
                self.wfile.write(block)
                type(self).sent += len(block)
        except OSError:
            return

    def do_HEAD(self) -> None:
        self.do_GET() if self.path.lstrip("/") == type(self).endless else super().do_HEAD()

    def log_message(self, *arguments: object) -> None:
        pass


@pytest.mark.parametrize("endless", ["bundle.json", "LICENSE"])
def test_an_endless_body_is_not_read_to_its_end(bundle: Path, tmp_path: Path, endless: str) -> None:
    pytest.importorskip("aiohttp")
    _Endless.endless, _Endless.sent = endless, 0
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Endless, directory=str(bundle)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{server.server_port}"
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        if endless == "bundle.json":
            with pytest.raises(DatasetError, match="longer than 128 MiB"):
                fetch(url, tmp_path / "out")
        else:
            report = fetch(url, tmp_path / "out")
            assert [name for name, _ in report.failed] == [endless]
            assert "longer than" in report.failed[0][1]
    finally:
        server.shutdown()
    # Three attempts of 128 MiB, and what the sockets hold.
    assert _Endless.sent < 600 << 20
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 600 << 10
    assert not list(tmp_path.rglob("*.tmp"))
