"""Records of the study: outcomes of jobs, errors of their models against exact truth, scores of the exact street.

While jobs run, each record is a JSON file of a working folder. Published records are the lines of one file,
`outcomes.jsonl`: each line is such a document with `campaign` and `kind` before its own keys.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias, get_args

from benchmarks.studies.static_reconstruction.arguments import Campaign
from benchmarks.studies.static_reconstruction.declaration import load_declaration
from benchmarks.studies.static_reconstruction.jobs import Job, outcome_file, outcomes_folder, truth_folder
from benchmarks.studies.static_reconstruction.methods import entries
from mirror.errors import DatasetError
from mirror.schema.files import write_bytes

Document: TypeAlias = dict[str, Any]
"""One record, with the keys that the job or the measurement wrote."""
Kind: TypeAlias = Literal["outcome", "truth", "exact_street"]

TUNING: Final = "tuning"
"""Folder of the trials in a working folder, and their campaign in the published file."""
EXACT_STREET_ROWS: Final = "ceiling"
"""Key of the rows of an exact street's scores."""
_KINDS: Final[tuple[Kind, ...]] = get_args(Kind)


@dataclass(frozen=True, eq=False)
class Records:
    """Current records: those of the committed declaration and of the settings that rows have now.

    Attributes:
        outcomes: of jobs.
        truth: of models whose outcomes are current; the models themselves may be gone.
        exact_street: of scenes.
    """

    outcomes: tuple[Document, ...]
    truth: tuple[Document, ...]
    exact_street: tuple[Document, ...]


def is_current(outcome: Document) -> bool:
    """Return whether an outcome is of the committed declaration and of its row's settings as they are now."""
    job = Job(**outcome["job"])
    entry = entries().get(job.entry)
    same_settings = entry is not None and outcome.get("settings") == entry.settings(job.seed)
    return same_settings and outcome["declaration"] == load_declaration().hash


def is_done(job: Job, folder: Path) -> bool:
    """Return whether a working folder has a job's outcome, and it is current."""
    path = outcome_file(folder, job)
    return path.is_file() and is_current(json.loads(path.read_text()))


def read_records(source: Path, campaign: Campaign = "main") -> Records:
    """Read the current records of a working folder, which has one campaign, or of a published file."""
    if source.is_file():
        return _current(_read_lines(source), campaign)
    return _current(_read_files(source), None)


def read_trials(source: Path) -> Records:
    """Read the current records of the tuning that a working folder or a published file has."""
    if source.is_file():
        return _current(_read_lines(source), TUNING)
    return _current(_read_files(source / TUNING), None)


def publish(folder: Path, published: Path, campaign: Campaign) -> None:
    """Put the current records of a working folder and of its tuning into a published file.

    A record takes the place of the published one of the same campaign, kind and job; all others stay. Scores of single
    images are left out, since no table needs them.
    """
    lines = {_key(line): line for line in _read_lines(published)} if published.is_file() else {}
    for name, records in ((campaign, read_records(folder)), (TUNING, read_trials(folder))):
        for kind, documents in zip(_KINDS, (records.outcomes, records.truth, records.exact_street)):
            for document in documents:
                without_scores = {key: value for key, value in document.items() if key != "scores"}
                line = {"campaign": name, "kind": kind, **without_scores}
                lines[_key(line)] = line
    text = "".join(json.dumps(lines[key], allow_nan=False) + "\n" for key in sorted(lines))
    write_bytes(published, text.encode())


def _read_files(folder: Path) -> Iterator[Document]:
    for path in sorted(outcomes_folder(folder).glob("*.json")):
        yield {"kind": "outcome", **json.loads(path.read_text())}
    for path in sorted(truth_folder(folder).glob("*.json")):
        document = json.loads(path.read_text())
        yield {"kind": "truth" if "job" in document else "exact_street", **document}


def _read_lines(published: Path) -> list[Document]:
    lines = []
    for number, text in enumerate(published.read_text().splitlines(), 1):
        line = json.loads(text)
        if line.get("kind") not in _KINDS or "campaign" not in line:
            raise DatasetError(
                "no record of the study", file=published, place=f"line {number}",
                expected=f"`campaign`, and `kind` of {', '.join(_KINDS)}", remedy="`publish` writes the file",
            )  # fmt: skip
        lines.append(line)
    return lines


def _current(lines: Iterable[Document], campaign: str | None) -> Records:
    """Current records of one campaign, without the keys that say what they are."""
    found: Mapping[Kind, list[Document]] = {kind: [] for kind in _KINDS}
    for line in lines:
        if line.get("campaign") == campaign:
            found[line["kind"]].append({key: line[key] for key in line if key not in ("campaign", "kind")})
    outcomes = [document for document in found["outcome"] if is_current(document)]
    jobs = {Job(**document["job"]) for document in outcomes}
    return Records(
        outcomes=tuple(outcomes),
        truth=tuple(document for document in found["truth"] if Job(**document["job"]) in jobs),
        exact_street=tuple(
            document for document in found["exact_street"] if document["declaration"] == load_declaration().hash
        ),
    )


def _key(line: Document) -> tuple[str, str, str]:
    name = Job(**line["job"]).name if "job" in line else f"{line['scene']}.{line['width_px']}px"
    return line["campaign"], line["kind"], name
