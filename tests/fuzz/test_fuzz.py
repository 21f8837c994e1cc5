"""Damaged recordings of every reader: refused by name, or ingested with right values; no traceback, hang or lost data.

``make test`` runs ten trials a reader; ``make fuzz`` runs five hundred (`MIRROR_FUZZ`) and prints their outcomes.
"""

from __future__ import annotations

import os
import shutil
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirror.errors import MirrorError
from mirror.ingest.run import ingest_recordings
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from tests.builders.folder import tree
from tests.fuzz.bases import BASES, REAL_BASES, Base
from tests.fuzz.judge import Reference, faults_of_untouched, faults_of_values, rows_of
from tests.fuzz.mutations import mutate
from tests.fuzz.worker import Request, Worker

TRIALS = int(os.environ.get("MIRROR_FUZZ", "10"))
VERBOSE = "MIRROR_FUZZ_VERBOSE" in os.environ
SEED = int(os.environ.get("MIRROR_FUZZ_SEED", "25"))
ERRORS = {kind.__name__ for kind in MirrorError.__subclasses__()}
DERIVED = ("dataset.json", "rois.geojson", "index/")


def linked(source: Path, target: Path) -> Path:
    return Path(shutil.copytree(source, target, copy_function=os.link))


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset with another drive at another place."""
    root = tmp_path_factory.mktemp("kept")
    rows = [f"{1_700_000_000 + second},{11.0 + 1e-4 * second},48.0" for second in range(30)]
    (root / "kept.csv").write_text("time,longitude,latitude\n" + "\n".join(rows) + "\n")
    scene = Roi(scene_id="kept", longitude_deg=11.0015, latitude_deg=48.0, radius_m=100.0)
    assert len(ingest_recordings([root / "kept.csv"], [scene], root / "d").traversals) == 1
    return root / "d"


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    """One process for all readers, which imports the libraries once."""
    with Worker() as worker:
        yield worker


def reference_of(base: Base, kept: Path, folder: Path) -> Reference:
    report = ingest_recordings([base.recording], [base.roi], linked(kept, folder))
    assert not report.failures and len(report.traversals) == 1, report.failures
    rows = rows_of(folder, report.traversals[0].traversal_id)
    assert not faults_of_values(rows)
    return Reference(base, rows, open_recording(base.recording, base.reader).track().timestamp_ns)


def judge(
    answer: dict[str, Any], before: dict[str, str], reference: Reference, damaged: Base, out: Path
) -> tuple[str, str | None]:
    """Return the outcome of one damaged recording, and its fault; None: the outcome is right.

    Args:
        answer: the worker's answer.
        before: hashes of the dataset's files before.
        reference: the result of the pristine recording.
        damaged: the damaged recording.
        out: the dataset.
    """
    if "failures" not in answer:
        return "no answer", str(answer)
    after = tree(out)
    if answer["failures"]:
        (failure,) = answer["failures"]
        if failure["error"] not in ERRORS or not failure["problem"] or not failure["file"]:
            return "no name", str(failure)
        # The list of recordings that could not be ingested names this one.
        rest = {name: digest for name, digest in after.items() if not name.startswith("failures/")}
        if len(after) != len(rest) + 1:
            return "refused", "the dataset does not list the recording"
        return "refused", None if rest == before else "the dataset has changed"
    changed = [name for name, digest in before.items() if not name.startswith(DERIVED) and after.get(name) != digest]
    if changed:
        return "taken", f"other files of the dataset have changed: {changed}"
    pristine = {file.relative_to(reference.base.path): file for file in reference.base.files}
    touched = {str(name) for name, file in pristine.items() if not _same(damaged.path / name, file)}
    faults = []
    for name in answer["traversals"]:
        rows = rows_of(out, name)
        faults += faults_of_values(rows) + faults_of_untouched(reference, rows, damaged, touched)
    dropped = sum(drive["poses"] - drive["kept"] for drive in answer["cleaning"])
    outcome = "taken without rows" if dropped else "taken"
    return outcome if answer["traversals"] else "no pass", "; ".join(faults[:3]) or None


def _same(file: Path, pristine: Path) -> bool:
    return file.is_file() and (file.samefile(pristine) or file.read_bytes() == pristine.read_bytes())


@pytest.mark.parametrize("reader", BASES)
def test_damage_is_refused_by_name_or_does_no_harm(reader: str, tmp_path: Path, kept: Path, worker: Worker) -> None:
    run_trials(BASES[reader](tmp_path / "base"), TRIALS, tmp_path, kept, worker)


@pytest.mark.real_data
@pytest.mark.parametrize("reader", REAL_BASES)
def test_damage_to_real_recordings(reader: str, real_data: Path, tmp_path: Path, kept: Path, worker: Worker) -> None:
    run_trials(REAL_BASES[reader](tmp_path / "base", real_data), max(1, TRIALS // 10), tmp_path, kept, worker)


def run_trials(base: Base, trials: int, tmp_path: Path, kept: Path, worker: Worker) -> None:
    """Damage a recording in many ways, ingest each damaged copy, and check every outcome."""
    reader = base.reader
    reference = reference_of(base, kept, tmp_path / "reference")
    before = tree(kept)
    counts: Counter[str] = Counter()
    faults = []
    slowest = 0.0
    for trial in range(trials):
        random = np.random.default_rng([SEED, list(BASES).index(reader), trial])
        folder = tmp_path / f"trial{trial}"
        path = linked(base.path, folder / base.path.name)
        kind, file = mutate(path, random)
        out = linked(kept, folder / "d")
        start_s = time.monotonic()
        damaged = Base(reader, path, base.roi, base.drive)
        answer = worker.ask(Request(damaged.recording, reader, base.roi, out))
        if "hang" in answer:
            # On a busy machine the first compilation of a kernel takes as long, but it ends.
            shutil.rmtree(out)
            answer = worker.ask(Request(damaged.recording, reader, base.roi, linked(kept, out)), timeout_s=120.0)
        slowest = max(slowest, time.monotonic() - start_s)
        outcome, fault = judge(answer, before, reference, damaged, out)
        counts[outcome] += 1
        damage = f"trial {trial}: {kind} of {file.relative_to(path)}"
        if fault is not None:
            faults.append(f"{damage}: {outcome}: {fault}")
        if VERBOSE:
            problem = answer["failures"][0]["problem"] if answer.get("failures") else ""
            print(f"{reader}, {damage}: {outcome}: {problem:.200}")
        shutil.rmtree(folder)
    print(f"{reader}: {trials} damaged recordings: {dict(counts)}; slowest {slowest:.1f} s")
    assert not faults, "\n".join(faults)
