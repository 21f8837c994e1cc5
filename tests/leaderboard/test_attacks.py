"""Attacks of a hostile participant on the board, each refused (docs/threat-model.md has the figures before)."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pydantic import ValidationError

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import SchemaError, UsageError
from mirror.evaluation.result import Result
from mirror.evaluation.run import EvaluationOptions, evaluate
from mirror.evaluation.submission.manifest import Appearance, Runtime, SubmittedMethod
from mirror.evaluation.submission.template import make_manifest, write_manifest
from mirror.metrics.boxes.raster import polygon_mask
from mirror.protocols.document import load_protocol, protocol_names
from mirror.protocols.png import encode_png
from mirror.protocols.views import RenderView, plan_views
from mirror.protocols.views.edited_region import target_hull
from mirror.schema.files import write_json
from mirror_leaderboard import add as add_module
from mirror_leaderboard.add import add_result
from mirror_leaderboard.boards import make_boards
from mirror_leaderboard.entry import Measured, Reported, load_entries
from mirror_leaderboard.keys import KEYS, OrganiserKeys, read_keys
from mirror_leaderboard.names import find_name_problem, skeleton
from mirror_leaderboard.refused import RefusedError
from mirror_leaderboard.rescore import Sources, require_plan
from mirror_leaderboard.signing import new_key
from mirror_leaderboard.site.page import build
from mirror_leaderboard.trust import require_trusted, rotate_key, sign_entries
from tests.evaluation.submissions import LEFT_HALF, SPLIT, small, write_renders
from tests.leaderboard.conftest import REPORTED, measured

SMALL = small(more=LEFT_HALF, every=10)


@pytest.fixture(scope="module")
def scored(dataset: Dataset, root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a submission ``s`` and its results ``out``."""
    folder = tmp_path_factory.mktemp("scored")

    def noisy(view: RenderView, truth: UInt8) -> UInt8:
        rng = np.random.default_rng(view.frame_index)
        return np.clip(truth + rng.normal(0, 4 + view.frame_index % 5, truth.shape), 0, 255).astype(np.uint8)

    write_renders(dataset, SMALL, folder / "s", noisy, name="honest")
    assert evaluate(folder / "s", root, SMALL, SPLIT, folder / "out", EvaluationOptions(workers=1)).result is not None
    return folder


@pytest.fixture
def result(scored: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the honest result, whose protocol the board knows."""
    monkeypatch.setattr(add_module, "protocol_names", lambda: ["small"])
    monkeypatch.setattr(add_module, "load_protocol", lambda name: SMALL)
    monkeypatch.setattr("mirror_leaderboard.entry.protocol_names", lambda: [*protocol_names(), "small"])
    out = tmp_path / "result"
    out.mkdir()
    for name in ("result.json", "images.parquet"):
        (out / name).write_bytes((scored / "out" / name).read_bytes())
    return out / "result.json"


def edit(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    plain = json.loads(path.read_text())
    change(plain)
    path.write_text(json.dumps(plain))


def louder(by: float) -> Callable[[dict[str, Any]], None]:
    def change(plain: dict[str, Any]) -> None:
        for figure in plain["figures"]:
            if figure["metric"].startswith("psnr") and figure["value"] is not None:
                figure["value"] += by
                figure.update({end: figure[end] + by for end in ("low", "high") if figure.get(end) is not None})

    return change


def edit_table(path: Path, change: Callable[[list[dict[str, Any]]], list[dict[str, Any]]]) -> None:
    table = pq.read_table(path.parent / "images.parquet")
    pq.write_table(pa.Table.from_pylist(change(table.to_pylist())), path.parent / "images.parquet")


def test_honest_result_is_scored_again_and_verified(scored: Path, result: Path, root: Path, tmp_path: Path) -> None:
    sources = Sources(str(root), scored / "s", workers=1)
    add_result(result, tmp_path / "board", "street", sources=sources)
    (entry,) = load_entries(tmp_path / "board" / "entries")
    assert isinstance(entry, Measured) and entry.verified and len(entry.pairs) == 3


def test_fifteen_decibels_in_table_and_result_are_found(scored: Path, result: Path, root: Path, tmp_path: Path) -> None:
    """Before: + 15 dB in `images.parquet` and `result.json` was accepted. After: refused, or unverified."""
    edit(result, louder(15.0))
    edit_table(result, lambda rows: [{**row, "psnr": row["psnr"] + 15.0} for row in rows])
    with pytest.raises(RefusedError, match="of psnr"):
        add_result(result, tmp_path / "board", "street", sources=Sources(str(root), scored / "s", workers=1))
    add_result(result, tmp_path / "board", "street", sources=Sources(str(root)))
    (entry,) = load_entries(tmp_path / "board" / "entries")
    assert isinstance(entry, Measured) and not entry.verified
    honest = measured("x", 20.0)
    verified = honest.model_copy(update={"verified": True, "version": "2"}).sealed()
    assert len(make_boards([honest, verified])) == 2


def test_deleting_the_worse_half_of_the_frames_is_found(result: Path, root: Path, tmp_path: Path) -> None:
    edit_table(result, lambda rows: rows[: len(rows) // 2])

    def fewer(plain: dict[str, Any]) -> None:
        rows = pq.read_table(result.parent / "images.parquet").to_pylist()
        for figure in plain["figures"]:
            if figure["metric"] in ("psnr", "ssim") and figure["level"] == "group":
                figure["value"], figure["n"] = float(np.mean([row[figure["metric"]] for row in rows])), len(rows)

    edit(result, fewer)
    with pytest.raises(RefusedError, match=r"not one for each|is not the mean"):
        add_result(result, tmp_path / "board", "street", sources=Sources(str(root)))


def test_forged_log_of_scores_is_found(scored: Path, result: Path, root: Path, tmp_path: Path) -> None:
    """A log of scores beside the submission raises the result that it is given to; `add` scores the renders again."""
    shutil.copytree(scored / "out", tmp_path / "out")
    log = tmp_path / "out" / "work" / "scored.jsonl"
    rows = [json.loads(line) for line in log.read_text().splitlines()]
    for row in rows:
        row["result"]["psnr"] += 15.0
    log.write_text("".join(f"{json.dumps(row)}\n" for row in rows))
    (tmp_path / "out" / "images.parquet").unlink()
    forged = evaluate(scored / "s", root, SMALL, SPLIT, tmp_path / "out", EvaluationOptions(workers=1))
    assert forged.reused == len(rows)
    with pytest.raises(RefusedError, match="of psnr"):
        sources = Sources(str(root), scored / "s", workers=1)
        add_result(tmp_path / "out" / "result.json", tmp_path / "board", "street", sources=sources)


@pytest.mark.parametrize("name", ["vehicle-translation", "generation", "editing-accuracy", "annotation"])
def test_figures_of_whole_sets_need_the_renders(result: Path, root: Path, tmp_path: Path, name: str) -> None:
    """Before: without renders, FID, KID, FVD, detection and editing kept the figures that the submitter stated."""
    plain = json.loads(result.read_text())
    protocol = load_protocol(name)
    stated = Result.model_validate({**plain, "protocol": protocol, "protocol_hash": protocol.hash})
    with pytest.raises(RefusedError, match="do not follow from the table of images"):
        require_plan(stated, result, str(root))


def test_times_of_an_unverified_row_are_those_of_its_manifest(dataset: Dataset, root: Path, tmp_path: Path) -> None:
    """Before: any figure of the task runtime was accepted."""
    protocol = load_protocol("runtime")
    plan = plan_views(dataset, protocol, SPLIT)
    runtime = Runtime(device="a GPU", frames_per_second=21.0)
    (tmp_path / "s").mkdir()
    write_manifest(
        tmp_path / "s", make_manifest(plan, SubmittedMethod(name="fast"), Appearance(policy="none"), runtime)
    )
    done = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", EvaluationOptions(workers=1))
    assert done.result is not None
    require_plan(done.result, tmp_path / "out" / "result.json", str(root))
    (figure,) = done.result.figures
    for change in ({"value": 2100.0}, {"group": "measured"}):
        edited = done.result.model_copy(update={"figures": (figure.model_copy(update=change),)})
        with pytest.raises(RefusedError, match="frames_per_second"):
            require_plan(edited, tmp_path / "out" / "result.json", str(root))


@pytest.mark.parametrize(
    ("figure", "value"),
    [
        ("frames_per_second", 1e12),
        ("training_s", 1e-9),
        ("peak_memory_bytes", 1),
        ("model_bytes", 0),
        ("driven_m", 1e300),
        ("training_s", 1e30),
    ],
)
def test_impossible_costs_are_a_problem_of_the_submission(figure: str, value: float) -> None:
    """Before: 10^12 frames a second and a training of 1e-9 s were verified."""
    with pytest.raises(ValidationError, match=figure):
        Runtime.model_validate({"device": "a GPU", figure: value})


GREY = """
import numpy as np


class Grey:
    def reconstruct(self, dataset, task, out, progress): ...

    def open(self, model, appearance):
        return lambda view: np.zeros((view.height_px, view.width_px, 3), np.uint8)


GREY = Grey()
"""


def test_costs_are_stated_unless_they_are_measured_here(
    dataset: Dataset, root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before: the figures of the manifest were verified, as they are its figures."""
    protocol = load_protocol("runtime")
    plan = plan_views(dataset, protocol, SPLIT)
    runtime = Runtime(device="a GPU", frames_per_second=9e5, training_s=0.5)
    (tmp_path / "s").mkdir()
    write_manifest(
        tmp_path / "s", make_manifest(plan, SubmittedMethod(name="fast"), Appearance(policy="none"), runtime)
    )
    assert evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", EvaluationOptions(workers=1)).result
    path, sources = tmp_path / "out" / "result.json", Sources(str(root), tmp_path / "s", workers=1)
    add_result(path, tmp_path / "board", "street", sources=sources)
    (entry,) = load_entries(tmp_path / "board" / "entries")
    assert isinstance(entry, Measured) and not entry.verified
    (board,) = make_boards([entry])
    assert dict(board.options) == {"stated:": "by the submissions, not measured here"}
    method = tmp_path / "method.py"
    method.write_text(GREY)
    monkeypatch.setattr("mirror.evaluation.scorers.speed.MIN_DURATION_S", 0.01)
    measured_here = replace(sources, measured=(f"{method}:GREY", tmp_path / "s"))
    add_result(path, tmp_path / "measured", "street", sources=measured_here)
    (entry,) = load_entries(tmp_path / "measured" / "entries")
    assert isinstance(entry, Measured) and entry.verified
    assert {figure.group for figure in entry.figures if figure.value is not None} == {"reported", "measured"}
    with pytest.raises(UsageError, match="protocol"):
        add_module._require_measured_here(
            add_module.read_result(path).model_copy(update={"protocol": SMALL}), measured_here, path
        )


@pytest.mark.parametrize("with_submission", [False, True])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda plain: plain.update(unavailable={"ssim": "no"}), r"needs no weights|unavailable"),
        (
            lambda plain: [
                figure.update(low=figure["value"] - 0.005, high=figure["value"] + 0.005)
                for figure in plain["figures"]
                if figure["value"] is not None
            ],
            r"low of",
        ),
        (lambda plain: plain.update(warnings=["all is well"]), "all is well"),
        (lambda plain: plain["submission"].update(seed=7), r"seed|submission"),
        (lambda plain: plain.update(figures=[f for f in plain["figures"] if f["level"] != "camera"]), "missing"),
    ],
)
def test_edited_result_is_refused(
    scored: Path,
    result: Path,
    root: Path,
    tmp_path: Path,
    with_submission: bool,
    change: Callable[[dict[str, Any]], None],
    message: str,
) -> None:
    """SSIM moved to unavailable, intervals of 0.01, warnings or breakdowns changed, another manifest."""
    edit(result, change)
    if not with_submission and message == r"seed|submission":
        pytest.skip("without the renders, nothing shows what the manifest was: the row is unverified")
    sources = Sources(str(root), scored / "s" if with_submission else None, workers=1)
    with pytest.raises(RefusedError, match=message):
        add_result(result, tmp_path / "board", "street", sources=sources)
    assert not (tmp_path / "board").exists() or not list((tmp_path / "board" / "entries").glob("*.json"))


def test_fitted_rows_stand_in_a_table_of_their_own(scored: Path, result: Path, root: Path, tmp_path: Path) -> None:
    edit(result, lambda plain: plain["submission"].update(appearance=Appearance(policy="fitted").model_dump()))
    entry = add_module.make_entry(add_module.read_result(result), "street", file=result)
    assert entry.options == {"appearance": "fitted"}


def test_unsigned_and_forged_rows_are_not_built(tmp_path: Path) -> None:
    """Before: a seal without a key, which anyone can write. After: `build` names the row and ends."""
    board, forged = tmp_path / "board", measured("forged", 38.0, pairs=())
    (board / "entries").mkdir(parents=True)
    file = board / "entries" / "measured-forged.json"
    write_json(file, measured("honest", 20.0, pairs=()))
    with pytest.raises(RefusedError, match="no public key"):
        build([board], tmp_path / "site")
    new_key(tmp_path / "organiser.key")
    assert [entry.method for entry in sign_entries(board, tmp_path / "organiser.key")] == ["honest"]
    assert sign_entries(board, tmp_path / "organiser.key") == []
    assert "honest" in build([board], tmp_path / "site").read_text()
    (signed,) = load_entries(board / "entries")
    assert isinstance(signed, Measured)
    for signature in (None, signed.signature):
        write_json(file, signed.model_copy(update={**dict(forged), "signature": signature, "key": signed.key}))
        with pytest.raises(RefusedError, match=r"forged .* signature"):
            build([board], tmp_path / "site")
    write_json(file, signed.model_copy(update={"method": "renamed"}))
    with pytest.raises(SchemaError, match="changed after it was added"):
        build([board], tmp_path / "site")
    new_key(tmp_path / "other.key")
    write_json(file, forged)
    with pytest.raises(UsageError, match="key in use"):
        sign_entries(board, tmp_path / "other.key")
    assert (tmp_path / "other.key").stat().st_mode & 0o777 == 0o600
    assert "Draft" in build([board], tmp_path / "draft", unsigned=True).read_text()
    (board / KEYS).write_text("no key")
    with pytest.raises(SchemaError, match="JSON"):
        build([board], tmp_path / "site")


FIRST, SECOND, LATER = date(2026, 1, 1), date(2026, 2, 1), date(2026, 3, 1)


@pytest.fixture
def signed_board(tmp_path: Path) -> Path:
    """A board whose entry `honest` was signed by `old.key` on the first day; `new.key` is beside it."""
    board = tmp_path / "board"
    write_json(board / "entries" / "measured-honest.json", measured("honest", 20.0, pairs=()))
    for name in ("old.key", "new.key", "third.key"):
        new_key(tmp_path / name)
    sign_entries(board, tmp_path / "old.key", FIRST)
    return board


def test_rotation_signs_again_what_a_listed_key_signed_and_nothing_else(signed_board: Path, tmp_path: Path) -> None:
    forged = measured("forged", 38.0, pairs=())
    file = signed_board / "entries" / "measured-forged.json"
    write_json(file, forged)
    done = rotate_key(signed_board, tmp_path / "new.key", SECOND)
    assert [entry.method for entry in done.signed] == ["honest"]
    assert [entry.method for entry in done.left] == ["forged"]
    with pytest.raises(RefusedError, match=r"forged .* has no signature"):
        build([signed_board], tmp_path / "site")
    file.unlink()
    assert "honest" in build([signed_board], tmp_path / "site").read_text()
    keys = read_keys(signed_board)
    assert keys is not None and [(key.since, key.until) for key in keys.keys] == [(FIRST, SECOND), (SECOND, None)]
    (entry,) = load_entries(signed_board / "entries")
    assert isinstance(entry, Measured) and (entry.key, entry.signed_on) == (keys.current.id, SECOND)
    # The same call again changes nothing; an interrupted one would continue.
    assert rotate_key(signed_board, tmp_path / "new.key", LATER).signed == ()
    assert read_keys(signed_board) == keys
    with pytest.raises(UsageError, match="has ended"):
        rotate_key(signed_board, tmp_path / "old.key", LATER)
    with pytest.raises(UsageError, match="key in use"):
        sign_entries(signed_board, tmp_path / "old.key", LATER)


def test_signature_of_a_former_key_counts_between_its_dates_alone(signed_board: Path, tmp_path: Path) -> None:
    (honest,) = load_entries(signed_board / "entries")
    assert isinstance(honest, Measured)
    other = tmp_path / "other"
    write_json(other / "entries" / "measured-late.json", measured("late", 25.0, pairs=()))
    sign_entries(other, tmp_path / "old.key", LATER)
    (late,) = load_entries(other / "entries")
    rotate_key(signed_board, tmp_path / "new.key", SECOND)
    require_trusted(signed_board, [honest])
    with pytest.raises(RefusedError, match="was signed on 2026-03-01; key"):
        require_trusted(signed_board, [late])
    assert isinstance(late, Measured)
    with pytest.raises(RefusedError, match="another key or content"):
        require_trusted(signed_board, [late.model_copy(update={"signed_on": FIRST})])
    write_json(other / KEYS, OrganiserKeys(keys=read_keys(signed_board).keys[1:]))  # type: ignore[union-attr]
    with pytest.raises(RefusedError, match="does not list"):
        require_trusted(other, [late])


def test_rotation_needs_a_new_key(signed_board: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="in use already"):
        rotate_key(signed_board, tmp_path / "old.key")
    (signed_board / KEYS).unlink()
    with pytest.raises(UsageError, match="no key yet"):
        rotate_key(signed_board, tmp_path / "new.key")


def test_broken_list_of_keys_is_refused(signed_board: Path) -> None:
    plain = json.loads((signed_board / KEYS).read_text())
    (key,) = plain["keys"]
    ended = {**key, "until": "2026-02-01"}
    for keys in ([], [ended], [key, key], [{**key, "id": "0" * 16}], [{**key, "until": "2025-01-01"}]):
        (signed_board / KEYS).write_text(json.dumps({"keys": keys}))
        with pytest.raises(SchemaError):
            read_keys(signed_board)


def test_reported_row_without_review_is_not_built(tmp_path: Path) -> None:
    entries = [entry for entry in load_entries(REPORTED) if isinstance(entry, Reported)]
    require_trusted(tmp_path, entries)
    first = entries[0].figures[0]
    assert first.value is not None
    better = first.model_copy(update={"value": first.value / 2})
    changed = entries[0].model_copy(update={"figures": (better, *entries[0].figures[1:])})
    with pytest.raises(RefusedError, match="reviewed"):
        require_trusted(tmp_path, [changed])


LOOKALIKES = (
    # Case, spaces, punctuation, digits and pairs of letters.
    "HYBRIDWORLDSIM", "Hybrid World Sim", "hybrid-world-sim", "Hybrid_WorldSim", "HybridWorldSim.", "HybridWorldSim...",
    "(HybridWorldSim)", "HybridWorldSim'", "HybridWorldSim*", "HybridWor1dSim", "HybridW0rldSim", "HybridWorIdSim",
    "HybrldWorldSim", "HybridWorldSirn", "HybridVVorldSim", "HybriclWorldSim",
    # Latin letters with other marks, and punctuation of other scripts.
    "HybridWorldS\u0131m", "Hybr\u00eddWorldSim", "HybridWorldSim\u00b7", "HybridWorldSim\u2019",
    "HybridWorldSim\u30fb", "HybridWorldSim\u4e36", "HybridWorldSim\u30fc", "Hybrid\u4e00WorldSim",
    # Other scripts: Greek, Cyrillic, Armenian, Hebrew, Ethiopic, Coptic, Lisu, Cherokee.
    "\u0397ybridWorldSim", "HybridW\u03bfrldSim", "\u041dybridWorldSim", "HybridW\u043erldSim", "Hybr\u0456dWorldSim",
    "HybridW\u0585rldSim", "HybridW\u05e1rldSim", "\u12d8ybridWorldSim", "\u2c8eybridWorldSim", "HybridW\u2c9frldSim",
    "\ua4e7ybridWorldSim", "\u13bbybridWorldSim",
    # Small capitals, mathematical and full-width letters, a Roman numeral.
    "\u029c\u028f\u0299\u0280\u026a\u1d05\u1d21\u1d0f\u0280\u029f\u1d05\ua731\u026a\u1d0d", "\U0001d5a7ybridWorldSim",
    "\uff28ybridWorldSim", "Hybr\u2170dWorldSim", "H\u0263bridWorldSim",
    # Invisible characters.
    "HybridWorldSim\u2800", "HybridWorldSim\u200b", "Hybrid\u00adWorldSim", "HybridWorldSim\u3164",
    "HybridWorldSim\u034f", "HybridWorldSim\ufe0f", "HybridWorldSim\u2060",
    "HybridWorldSim\U000e0020", "Hybrid\u00a0WorldSim",
)  # fmt: skip


def test_fifty_lookalikes_of_a_name_are_refused(result: Path, board: Path) -> None:
    """Before: 35 of them were accepted. `board` has HybridWorldSim."""
    assert len(set(LOOKALIKES)) == 50
    for name in LOOKALIKES:
        assert find_name_problem(name) is not None or skeleton(name) == skeleton("HybridWorldSim"), ascii(name)
    for name in ("HybridWorldSim*", "HybridW\u05e1rldSim"):
        edit(result, lambda plain, name=name: plain["submission"]["method"].update(name=name))
        with pytest.raises(RefusedError, match=r"'HybridWorldSim'|several scripts"):
            add_result(result, board, "street")


def test_a_name_of_another_script_that_reads_like_a_latin_one_has_its_skeleton() -> None:
    """Names of one script are allowed, and compared with those of others."""
    for name, latin in (("\u0441\u043e\u0440\u0443", "copy"), ("\u0391\u0392\u0395", "ABE"), ("\u05d5\u05e1", "lo")):
        assert find_name_problem(name) is None and skeleton(name) == skeleton(latin)


@pytest.mark.parametrize(
    "name",
    [
        " mine",
        "mine ",
        "mi\u200bne",
        "mi\u00adne",
        "ｍｉｎｅ",
        "mine\u3164",
        "mi\ufe0fne",
        "m  e",
        "...",
        "1\u0661",
        "m\u0307i",
    ],
)
def test_characters_that_no_plain_name_has_are_refused(name: str) -> None:
    assert find_name_problem(name) is not None


def test_plain_names_stay() -> None:
    names = (
        "HybridWorldSim",
        "mtgs_style",
        "3DGS (ours, 30k)",
        "世界モデル",
        "Ünïcode-GS",
        "世界GS",
        "ガウスGS",
        "GS한국어",
        "हिन्दी",
        "Мир",
    )
    for name in names:
        assert find_name_problem(name) is None
    methods = [
        "vanilla_3dgs",
        "mtgs_style",
        "omnire_style",
        "nearest_frame",
        "mean_color",
        "grey_frame",
        "DriveEditor",
        "4DGS",
        "4DGS+",
    ]
    assert len({skeleton(name) for name in methods}) == len(methods)


def test_two_variants_of_one_method_are_distinct_on_the_page(tmp_path: Path) -> None:
    board = tmp_path / "board"
    (board / "entries").mkdir(parents=True)
    for version in ("1", "2"):
        write_json(board / "entries" / f"{version}.json", measured("twin", 20.0, pairs=(), version=version))
    page = build([board], tmp_path / "site", unsigned=True).read_text()
    assert "version 1" in page and "version 2" in page


def test_the_key_is_the_first_figure_and_no_colour_fit() -> None:
    for name in ("static-reconstruction", "lane-shift"):
        protocol = load_protocol(name)
        assert protocol.ranking is not None and protocol.ranking.metric == "matched_structure"
        assert protocol.metric_names[:4] == ("matched_structure", "psnr", "psnr_invariant", "psnr_affine")


def test_the_result_does_not_choose_the_extractor(tiny_dataset: Dataset, tmp_path: Path) -> None:
    """Before: grey renders and masks of the target boxes had an IoU of 1.0, verified. After: refused, or unverified."""
    protocol = load_protocol("editing-accuracy-small")
    root, masks, submission = Path(tiny_dataset.root), tmp_path / "masks", tmp_path / "s"
    plan = write_renders(tiny_dataset, protocol, submission, lambda view, truth: np.full_like(truth, 128))
    for view in plan.views:
        hull = np.empty((0, 2)) if not view.edits else target_hull(view, view.edits[0])
        file = masks / view.path.removeprefix("renders/")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(encode_png(polygon_mask(hull, view.width_px, view.height_px).astype(np.uint8) * 255))
    chosen = f"file:{masks}"
    options = EvaluationOptions(workers=1, extractor=chosen)
    done = evaluate(submission, root, protocol, SPLIT, tmp_path / "forged", options).result
    assert done is not None and done.options == {"extractor": "file"}
    values = {figure.metric: figure.value for figure in done.figures if figure.group == "all"}
    assert values["edit_iou_hull"] == pytest.approx(1.0)
    board, result = tmp_path / "board", tmp_path / "forged" / "result.json"
    built_in = Sources(str(root), submission, workers=1)
    for stated in ("file", chosen, "diff-grabcut"):
        edit(result, lambda plain, stated=stated: plain["options"].update(extractor=stated))
        with pytest.raises(RefusedError, match=r"options|edit_iou"):
            add_result(result, board, "street", sources=built_in)
    edit(result, lambda plain: plain["options"].update(extractor="file"))
    add_result(result, board, "street", sources=replace(built_in, extractor=chosen))
    (entry,) = load_entries(board / "entries")
    assert isinstance(entry, Measured) and not entry.verified
    (table,) = make_boards([entry])
    assert ("unverified:", "the regions are not those of the built-in extractor") in table.options
    honest = evaluate(submission, root, protocol, SPLIT, tmp_path / "honest", EvaluationOptions(workers=1)).result
    assert honest is not None
    add_result(tmp_path / "honest" / "result.json", board, "street", setting="built-in", sources=built_in)
    by_setting = {entry.setting: entry for entry in load_entries(board / "entries") if isinstance(entry, Measured)}
    assert by_setting["built-in"].verified
    assert len(make_boards(list(by_setting.values()))) == 2


def test_an_unverified_result_opens_no_table_by_an_option(result: Path, root: Path, tmp_path: Path) -> None:
    """Before: any option in `result.json` gave the row a table of its own, where it was the best. After: refused."""
    edit(result, lambda plain: plain.update(options={"extractor": "mine"}))
    with pytest.raises(RefusedError, match="options"):
        add_result(result, tmp_path / "board", "street", sources=Sources(str(root)))
