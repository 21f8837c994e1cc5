"""An image that was taken down is neither de-identified again nor released."""

from __future__ import annotations

from pathlib import Path

import mirror
from mirror.cli.main import main
from mirror.dataset.layout import Layout
from mirror.dataset.take_down import take_down
from mirror.executors.choice import ExecutorChoice
from mirror.privacy.log import read_log
from mirror.privacy.release.review import ReviewSession
from mirror.privacy.run import deidentify
from mirror.privacy.summary import read_examples
from tests.privacy.conftest import options


def test_later_redactions_and_releases_leave_the_image_out(dataset: Path, tmp_path: Path) -> None:
    row = mirror.open(dataset).table("images").to_pylist()[1]
    key = row["traversal_id"], row["camera"], row["timestamp_ns"]
    # Its bytes are gone, so that whoever reads them fails.
    assert len(take_down(dataset, [key], purge_originals=True).purged) == 2
    assert deidentify(dataset, options(version="2", executor=ExecutorChoice("serial"))).exit_code() == 0
    layer = Layout(dataset).layer(key[0], "redaction", "deidentify", "2")
    assert key not in {one.key for one in read_log(layer / "log.jsonl")}
    assert mirror.open(dataset).count("images") == 17
    # Neither the figure of a plot nor the page of a review looks for it.
    examples = read_examples(mirror.open(dataset), 20)
    assert len(examples) + (key[1] != "rear_left") == 12
    assert key not in {one.key for one in ReviewSession(dataset, "anna", 100).sample}
    what = ["--name", "marks", "--licence", "CC0-1.0", "--contact", "a@example.org", "--sample", "0", "--keep-ids"]
    assert main(["release", "build", str(dataset), *what, "--out", str(tmp_path / "release")]) == 0
    assert main(["release", "check", str(tmp_path / "release"), "--originals", str(dataset)]) == 0
    assert mirror.open(tmp_path / "release").count("images") == 17
    assert not list((tmp_path / "release").rglob(f"{key[1]}/{key[2]}.*"))
    assert main(["dataset", "take-down", str(tmp_path / "release"), "--image", "/".join(map(str, key))]) == 2
