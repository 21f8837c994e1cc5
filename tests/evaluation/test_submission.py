"""Templates and checks: all problems are listed at once, and only expected files are opened."""

from __future__ import annotations

import json
import pickle
import shutil
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.evaluation.submission.check import check_submission
from mirror.evaluation.submission.manifest import read_manifest
from mirror.evaluation.submission.template import expected_files, write_template
from mirror.evaluation.submission.untrusted import UntrustedError, open_untrusted
from mirror.geometry.poses import to_pose_numbers
from mirror.protocols.png import encode_png
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views import Plan, plan_views
from tests.evaluation.png_chunks import chunk, png
from tests.evaluation.submissions import SPLIT, small, small_text, write_renders


@pytest.fixture(scope="module")
def complete(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, Path]:
    out = tmp_path_factory.mktemp("submissions") / "complete"
    return write_renders(dataset, small(), out), out


def test_complete_submission_has_no_problem(complete: tuple[Plan, Path]) -> None:
    plan, folder = complete
    report = check_submission(open_untrusted(folder), plan)
    assert report.problems == ()
    assert report.expected == report.present == len(plan.views)
    assert report.hash == check_submission(open_untrusted(folder), plan).hash


def test_only_decoding_finds_missing_pixels_with_valid_checksums(
    complete: tuple[Plan, Path], root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, folder = complete
    broken = tmp_path / "broken"
    shutil.copytree(folder, broken)
    view = plan.views[2]
    rows = zlib.compress(bytes((3 * view.width_px + 1) * (view.height_px - 1)))
    (broken / view.path).write_bytes(png(chunk(b"IDAT", rows), width=view.width_px, height=view.height_px))
    quick = check_submission(open_untrusted(broken), plan)
    assert quick.problems == ()
    assert quick.not_checked == (
        f"the pixels of {len(plan.views)} images: `mirror submission check --decode` decodes them",
    )
    slow = check_submission(open_untrusted(broken), plan, decode=True)
    assert [(problem.kind, problem.path) for problem in slow.problems] == [("corrupt", view.path)]
    assert slow.not_checked == ()
    whole_one = check_submission(open_untrusted(folder), plan, decode=True)
    assert whole_one.problems == whole_one.not_checked == ()
    assert whole_one.hash == check_submission(open_untrusted(folder), plan).hash
    protocol = tmp_path / "small.toml"
    protocol.write_text(small_text())
    words = ["submission", "check", str(root), str(broken), "--protocol", str(protocol)]
    assert main(words) == 0
    assert f"not checked: the pixels of {len(plan.views)} images: " in capsys.readouterr().out
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["not_checked"] == list(quick.not_checked)
    assert main([*words, "--decode"]) == 1
    said = capsys.readouterr().out
    assert view.path in said
    assert "not checked" not in said


def test_manifest_with_a_repeated_key_is_refused(complete: tuple[Plan, Path], tmp_path: Path) -> None:
    plan, folder = complete
    shutil.copytree(folder, tmp_path / "twice")
    manifest = tmp_path / "twice" / "manifest.json"
    manifest.write_text(manifest.read_text().replace("{", '{"split": "another", ', 1))
    report = check_submission(open_untrusted(tmp_path / "twice"), plan)
    assert [(problem.kind, problem.message) for problem in report.problems] == [
        ("manifest", "the key 'split' stands twice in one object")
    ]


def test_zip_is_equal_to_its_folder(complete: tuple[Plan, Path], tmp_path: Path) -> None:
    plan, folder = complete
    archive = Path(shutil.make_archive(str(tmp_path / "s"), "zip", folder))
    zipped, plain = (check_submission(open_untrusted(path), plan) for path in (archive, folder))
    assert zipped.problems == ()
    assert zipped.hash == plain.hash


class Harm:
    """Writes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[Path]]:
        return (Path.touch, (self.path,))


def test_all_problems_are_listed_at_once(complete: tuple[Plan, Path], tmp_path: Path) -> None:
    plan, folder = complete
    broken = tmp_path / "broken"
    shutil.copytree(folder, broken)
    paths = [view.path for view in plan.views]
    (broken / paths[0]).unlink()
    (broken / paths[1]).write_bytes((broken / paths[1]).read_bytes()[:-20])
    (broken / paths[2]).write_bytes(encode_png(np.zeros((7, 11, 3), np.uint8)))
    deep = cv2.imencode(".png", np.zeros((plan.views[3].height_px, plan.views[3].width_px, 3), np.uint16))[1]
    (broken / paths[3]).write_bytes(deep.tobytes())
    (broken / paths[4]).unlink()
    (broken / paths[4]).symlink_to(folder / paths[4])
    (broken / paths[5]).write_bytes(bytes(10_000_000))
    (broken / "renders" / "model.pkl").write_bytes(pickle.dumps(Harm(tmp_path / "harm")))
    # A file without read permission: opening it would fail.
    (broken / "extra.npy").write_bytes(b"x")
    (broken / "extra.npy").chmod(0)
    manifest = json.loads((broken / "manifest.json").read_text())
    manifest["plan_hash"] = "0" * 64
    (broken / "manifest.json").write_text(json.dumps(manifest))
    report = check_submission(open_untrusted(broken), plan)
    assert report.problems[0].kind == "manifest"
    problems = {(problem.kind, problem.path) for problem in report.problems}
    assert problems == {
        ("missing", paths[0]),
        ("corrupt", paths[1]),
        ("wrong size", paths[2]),
        ("corrupt", paths[3]),
        ("refused", paths[4]),
        ("corrupt", paths[5]),
        ("extra", "renders/model.pkl"),
        ("extra", "extra.npy"),
        ("manifest", "manifest.json"),
    }
    assert not (tmp_path / "harm").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"method": {"name": ""}}, "method.name"),
        ({"appearance": {"policy": "fitted", "held_out_pixels": []}}, "held_out_pixels"),
        ({"unknown": 1}, "unknown"),
        ({"method": {"name": "x", "url": "javascript:alert(1)"}}, "method.url"),
        ({"protocol_hash": "short"}, "protocol_hash"),
        ({"method": {"name": "\x1b[2Jgone"}}, "method.name"),
        ({"method": {"name": "two\nlines"}}, "method.name"),
        ({"notes": "\u202eback"}, "notes"),
        ({"runtime": {"device": "cpu", "frames_per_second": -1}}, "frames_per_second"),
    ],
)
def test_wrong_manifest_is_named(
    complete: tuple[Plan, Path], tmp_path: Path, change: dict[str, object], words: str
) -> None:
    manifest = {**json.loads((complete[1] / "manifest.json").read_text()), **change}
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(UntrustedError, match=words):
        read_manifest(open_untrusted(tmp_path))


def test_template_lists_every_file_with_pose_lens_and_mask(dataset: Dataset, tmp_path: Path) -> None:
    protocol = small()
    plan = plan_views(dataset, protocol, SPLIT)
    truth = GroundTruth(dataset, protocol, plan.layers)
    assert write_template(tmp_path / "open", plan, truth) == len(plan.views)
    assert write_template(tmp_path / "blind", plan, truth, blind=True) == len(plan.views)
    listed = json.loads((tmp_path / "open" / "views.json").read_text())
    assert {row["path"] for row in listed["views"]} == set(expected_files(plan))
    masked = 0
    for row, view in zip(listed["views"], plan.views):
        assert row["world_SE3_camera"] == pytest.approx(list(to_pose_numbers(view.world_SE3_camera)))
        assert (row["width_px"], row["height_px"], row["fx_px"]) == (view.width_px, view.height_px, view.fx_px)
        assert row["recorded"]["uri"]
        if row["mask"] is not None:
            mask = cv2.imread(str(tmp_path / "open" / row["mask"]), cv2.IMREAD_UNCHANGED)
            np.testing.assert_array_equal(mask > 0, truth.scored_mask(view))
            masked += 1
    assert masked > 0
    blind = (tmp_path / "blind" / "views.json").read_text()
    assert "recorded" not in blind
    assert "uri" not in blind
    for file in (tmp_path / "blind").rglob("*.png"):
        assert cv2.imread(str(file), cv2.IMREAD_UNCHANGED).ndim == 2
    # As a submission, an unchanged template has no renders and an incomplete manifest.
    report = check_submission(open_untrusted(tmp_path / "open"), plan)
    assert report.counts() == {"manifest": 1, "missing": len(plan.views)}
    # The two fields that the README names are all that is missing in the manifest.
    manifest = json.loads((tmp_path / "open" / "manifest.json").read_text())
    manifest["method"]["name"], manifest["appearance"]["policy"] = "mine", "nearest-traversal"
    (tmp_path / "open" / "manifest.json").write_text(json.dumps(manifest))
    assert "nearest-traversal" in (tmp_path / "open" / "README.md").read_text()
    assert check_submission(open_untrusted(tmp_path / "open"), plan).counts() == {"missing": len(plan.views)}


def test_commands(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new"
    words = ["--protocol", "static-reconstruction", "--split", SPLIT]
    assert main(["submission", "new", str(root), *words, "--out", str(out), "--blind", "--json"]) == 0
    expected = json.loads(capsys.readouterr().out)["expected"]
    assert main(["submission", "check", str(root), str(out), "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert said["counts"] == {"manifest": 1, "missing": expected}
    assert main(["submission", "check", str(root), str(out)]) == 1
    assert f"missing: {expected}" in capsys.readouterr().out
    assert main(["submission", "new", str(root), *words, "--out", str(out)]) == 2
    assert main(["submission", "old"]) == 2
    assert main(["submission", "new", str(root), "--protocol", "safety", "--split", SPLIT, "--out", str(out)]) == 2
    assert "mirror evaluate RUN" in capsys.readouterr().err


@pytest.mark.parametrize("verb", [["submission", "check"], ["evaluate"]])
def test_other_problems_are_listed_beside_an_unreadable_manifest(
    complete: tuple[Plan, Path], root: Path, tmp_path: Path, verb: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    plan, folder = complete
    shutil.copytree(folder, tmp_path / "s")
    (tmp_path / "s" / "manifest.json").write_text("{")
    (tmp_path / "s" / "link").symlink_to("/")
    words = [*verb, str(root), str(tmp_path / "s"), "--json"]
    assert main(words) == 1
    said = json.loads(capsys.readouterr().out)
    assert [problem["kind"] for problem in said["problems"]] == ["manifest", "refused"]
    assert "--protocol and --split" in said["problems"][0]["message"]
    (tmp_path / "s" / plan.views[0].path).unlink()
    protocol = tmp_path / "small.toml"
    protocol.write_text(small_text())
    assert main([*words, "--protocol", str(protocol), "--split", SPLIT]) == 1
    said = json.loads(capsys.readouterr().out)
    assert [problem["kind"] for problem in said["problems"]] == ["manifest", "refused", "missing"]
    assert main(words[:-1]) == 1
    assert "2 problems" in capsys.readouterr().out
