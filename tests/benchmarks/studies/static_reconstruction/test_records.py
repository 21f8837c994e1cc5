"""Which records are current, and which records publishing keeps."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from benchmarks.studies.static_reconstruction.arguments import Arguments
from benchmarks.studies.static_reconstruction.declaration import load_declaration
from benchmarks.studies.static_reconstruction.jobs import Job, exact_street_file, outcome_file, truth_file
from benchmarks.studies.static_reconstruction.methods import OURS, entries
from benchmarks.studies.static_reconstruction.records import TUNING, is_done, publish, read_records, read_trials
from benchmarks.studies.static_reconstruction.tables import read_results
from benchmarks.studies.static_reconstruction.verbs import VERBS
from mirror.errors import DatasetError, ExitCode

JOB = Job(OURS, "guangzhou-urban", 1, 10.0, 240)
MEANS = {"psnr": 30.0, "psnr_cc": 20.0, "ssim": 0.8, "st_lpips": 0.1}


def write_json(path: Path, document: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document))


def write_outcome(folder: Path, of: Job = JOB, **changes: Any) -> None:
    document = {
        "job": asdict(of), "declaration": load_declaration().hash, "dataset_hash": "d", "core_s": 600.0,
        "settings": entries()[of.entry].settings(of.seed),
        "model_bytes": 5_000_000, "gaussians": 7, "steps": 3, "means": {"training": MEANS, "novel": MEANS},
        "oracle": MEANS, "scores": [{"path": "a", "psnr": 30.0}],
    }  # fmt: skip
    write_json(outcome_file(folder, of), {**document, **changes})


def test_a_current_outcome_counts(tmp_path: Path) -> None:
    write_outcome(tmp_path)
    assert is_done(JOB, tmp_path)
    assert [outcome["job"] for outcome in read_records(tmp_path).outcomes] == [asdict(JOB)]
    assert not is_done(replace(JOB, seed=2), tmp_path)


@pytest.mark.parametrize(
    "changes",
    [
        {"declaration": "another"},
        {"settings": {**entries()[OURS].settings(1), "structure_weight": 0.5}},
        {"settings": entries()[OURS].settings(0)},
        {"settings": None},
        {"job": {**asdict(JOB), "entry": "a row that is gone"}},
    ],
)
def test_an_outcome_of_another_declaration_row_or_settings_does_not_count(
    changes: dict[str, Any], tmp_path: Path
) -> None:
    write_outcome(tmp_path, **changes)
    assert not is_done(JOB, tmp_path) and read_records(tmp_path).outcomes == ()


def test_outcomes_of_two_datasets_are_not_combined(tmp_path: Path) -> None:
    write_outcome(tmp_path)
    write_outcome(tmp_path, replace(JOB, seed=2), dataset_hash="another")
    with pytest.raises(DatasetError, match="outcomes of 2 datasets"):
        read_results(read_records(tmp_path).outcomes)


def test_training_images_of_fewer_traversals_are_not_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for entry in ("4-traversals", "1-traversals"):
        write_outcome(tmp_path, replace(JOB, entry=entry, seed=0))
    VERBS["show"](Arguments("show", tmp_path, group="ablation"), load_declaration())
    text = capsys.readouterr().out
    assert "| 1-traversals | - | - | - | 30.00 | 20.00 |" in text
    assert "| 4-traversals | 30.00 | 0.800 | 0.100 | 30.00 |" in text
    assert "| 1-traversals | - | - | - | +0.000 |" in text


def test_published_records_are_shown_as_working_records(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    write_outcome(data)
    tuning = load_declaration().tuning
    trial = Job("ours+rates1+sizes1", tuning.scene, 0, tuning.core_minutes, 240)
    write_outcome(data / TUNING, trial)
    write_outcome(data, replace(JOB, seed=2), declaration="another")
    arguments = Arguments(data=data, out=out)
    assert VERBS["publish"](arguments, load_declaration()) == ExitCode.DONE
    lines = [json.loads(line) for line in arguments.outcomes.read_text().splitlines()]
    assert [(line["campaign"], line["kind"], line["job"]) for line in lines] == [
        ("main", "outcome", asdict(JOB)), (TUNING, "outcome", asdict(trial)),
    ]  # fmt: skip
    assert not any("scores" in line for line in lines)
    shown = []
    for published in (False, True):
        capsys.readouterr()
        VERBS["show"](replace(arguments, what="show", published=published), load_declaration())
        shown.append(capsys.readouterr().out)
    assert shown[0] == shown[1]
    assert "| ours | 30.00 |" in shown[0] and "30.00 / 20.00" in shown[0]


def test_publishing_replaces_the_same_records_and_keeps_the_others(tmp_path: Path) -> None:
    data, published, second = tmp_path / "data", tmp_path / "outcomes.jsonl", replace(JOB, seed=2)
    for job, steps in ((JOB, 1), (second, 2)):
        write_outcome(data, job, steps=steps)
    publish(data, published, "main")
    write_outcome(data, steps=3)
    outcome_file(data, second).unlink()
    publish(data, published, "main")
    publish(data, published, "repeated")
    assert [outcome["steps"] for outcome in read_records(published).outcomes] == [3, 2]
    assert [outcome["steps"] for outcome in read_records(published, "repeated").outcomes] == [3]
    assert read_trials(published).outcomes == ()
    # Equal records give equal bytes.
    before = published.read_bytes()
    publish(data, published, "main")
    assert published.read_bytes() == before


def test_a_line_of_another_kind_is_refused(tmp_path: Path) -> None:
    published = tmp_path / "outcomes.jsonl"
    published.write_text('{"campaign": "main", "kind": "other"}\n')
    with pytest.raises(DatasetError, match="line 1: no record of the study"):
        read_records(published)


def test_truth_of_a_current_outcome_is_shown_after_its_model_is_gone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, stale = Arguments("truth", tmp_path / "data", out=tmp_path / "out"), replace(JOB, seed=2)
    ground = {"surface": "as drawn", "bias_m": -0.01, "median_m": 0.02, "p90_m": 0.03}
    costs = {"fps": 11.0, "wall_ms": 90.0, "core_ms": 10.0, "mb_per_100_m": 12.0, "threads": 1, "size_px": [480, 270]}
    for job, median_m, changes in ((JOB, 0.02, {}), (stale, 0.5, {"declaration": "another"})):
        write_outcome(arguments.data, job, **changes)
        nothing: dict[str, Any] = {"depth": [], "lighting": [], "seam": []}
        document = {"job": asdict(job), "ground": [{**ground, "median_m": median_m}], "costs": costs, **nothing}
        write_json(truth_file(arguments.data, job), document)
    row = {"group": "novel", "light": "own", "poses": "true", "pictures": 3, "psnr": 40.0, "psnr_cc": 41.0, "ssim": 0.9}
    for scene, declaration in ((JOB.scene, load_declaration().hash), ("karlsruhe-rural", "another")):
        exact = {"declaration": declaration, "scene": scene, "width_px": 240, "ceiling": [row]}
        write_json(exact_street_file(arguments.data, scene, 240), exact)
    VERBS["publish"](arguments, load_declaration())
    lines = [json.loads(line) for line in arguments.outcomes.read_text().splitlines()]
    assert [line["kind"] for line in lines] == ["exact_street", "outcome", "truth"]
    for published in (False, True):
        capsys.readouterr()
        VERBS["truth"](replace(arguments, published=published), load_declaration())
        text = capsys.readouterr().out
        assert "| ours | as drawn | -0.010 | 0.020 | 0.030 |" in text and "| ours | 11 |" in text
        assert f"| novel | own | true | {JOB.scene} | 40.00 | 41.00 | 0.900 | 3 |" in text and "| mean |" not in text
