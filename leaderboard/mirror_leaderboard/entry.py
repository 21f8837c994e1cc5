"""Entries of the leaderboard, one JSON file each."""

from __future__ import annotations

from collections import Counter
from datetime import date
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, RootModel, model_validator

from mirror.errors import DatasetError, SchemaError
from mirror.evaluation.submission.manifest import MOST_FRAMES_PER_SECOND
from mirror.metrics.catalogue import MEASURES
from mirror.protocols.document import protocol_names
from mirror.schema.documents import Document
from mirror.schema.files import read_json
from mirror.schema.hashing import HashStyle, hash_document
from mirror.schema.suite_run import Isolation
from mirror_leaderboard.keys import KeyId

IMAGE_FOLDER: Final = "pictures"
"""Folder of images, in a board beside its folder of entries, and in the site."""

_SIGNATURE: Final = ("key", "signed_on", "signature")
"""Fields of a measured entry that its seal does not cover."""

Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Name = Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[^\x00-\x1f\x7f<>]+$")]
Note = Annotated[str, Field(max_length=400, pattern=r"^[^\x00-\x1f\x7f]+$")]
ImageFile = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_\-]{0,79}(/[a-z0-9][a-z0-9_\-]{0,79})?\.jpg$")]
Signature = Annotated[str, Field(pattern=r"^[A-Za-z0-9+/]{86}==$")]
Link = Annotated[str, Field(max_length=200, pattern=r"^https://[A-Za-z0-9.\-]+(/[A-Za-z0-9._~/%\-]*)?$")]


class Figure(Document):
    """One figure of one group of renders.

    Attributes:
        group: group of the protocol; ``all``: all groups together.
        metric: key of `MEASURES`.
        value: the value; None if there is none, with the reason in ``note``.
        low: lower end of the confidence interval.
        high: upper end of the confidence interval.
        n: number of images, clips or boxes.
        n_missing: number of these without a value, such as images without scored pixels.
        n_infinite: number of images that equal the truth: their PSNR is infinite and is not part of ``value``.
        note: remark on the figure.
    """

    group: Name
    metric: str
    value: float | None = Field(allow_inf_nan=False)
    low: float | None = Field(default=None, allow_inf_nan=False)
    high: float | None = Field(default=None, allow_inf_nan=False)
    n: int | None = Field(default=None, ge=0)
    n_missing: int = Field(default=0, ge=0)
    n_infinite: int = Field(default=0, ge=0)
    note: Note | None = None

    @model_validator(mode="after")
    def _possible(self) -> Figure:
        measure = MEASURES.get(self.metric)
        if measure is None or not measure.is_listed:
            raise ValueError(f"metric {self.metric!r} is unknown")
        if self.value is None:
            if not self.note:
                raise ValueError(f"{self.metric} of {self.group} has no value and no note with the reason")
            return self
        if not measure.low <= self.value <= measure.high:
            raise ValueError(f"{self.metric} {self.value:g} lies outside {measure.low:g} to {measure.high:g}")
        if (self.low is None) != (self.high is None):
            raise ValueError(f"{self.metric} of {self.group} has only one end of a confidence interval")
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError(f"the interval of {self.metric} of {self.group} ends before it begins")
        return self


class Paper(Document):
    """The place of a reported figure in a paper.

    Attributes:
        title: title of the paper.
        table: number of the table.
        label: label of the table in the paper's LaTeX source.
        row: name of the method in the table.
        url: address of the paper.
        date: year and month of the paper, and its day if it is known.
        about: description of the figures, in the words of the table.
    """

    title: str
    table: int = Field(ge=1)
    label: str
    row: str
    url: Link
    date: Annotated[str, Field(pattern=r"^\d{4}-\d{2}(-\d{2})?$")]
    about: Note


class Reported(Document):
    """Figures from a paper, which were not measured by this toolkit.

    Attributes:
        kind: tag of the type.
        method: name of the method.
        link: home page of the method.
        protocol: the protocol that is most similar to the paper's evaluation.
        dataset: dataset of the figures; None if the paper does not state it.
        setting: setting that distinguishes rows of one method.
        paper: place in the paper.
        figures: the printed figures.
        notes: remarks for a comparison.
    """

    kind: Literal["reported"] = "reported"
    method: Name
    link: Link | None = None
    protocol: str
    dataset: Name | None
    setting: Name | None = None
    paper: Paper
    figures: tuple[Figure, ...] = Field(min_length=1)
    notes: tuple[Note, ...] = ()


class Cluster(Document):
    """The ranking figure's mean in one cluster: a scene, or a scenario in a scene.

    Attributes:
        key: the scene, or ``SCENE, SCENARIO``.
        value: its mean there.
        weight: share of the cluster in the figure; all shares have the sum 1.
        n: number of scores.
    """

    key: Note
    value: float = Field(allow_inf_nan=False)
    weight: float = Field(gt=0, le=1 + 1e-9)
    n: int = Field(ge=1)


class Pair(Document):
    """One view of a method beside its truth.

    Attributes:
        view: scene, camera and condition of the view.
        render: file of the render, relative to the folder of images.
        truth: file of the recorded image.
    """

    view: Name
    render: ImageFile
    truth: ImageFile


COMMITMENT: Final = "drives of a test split, committed to"
"""Option of entries of a suite with a secret: the SHA-256 of the secret."""


class Measured(Document):
    """Figures of an evaluation; written by ``mirror leaderboard add``.

    Attributes:
        kind: tag of the type.
        method: name of the method.
        version: version of the method.
        link: home page of the method.
        protocol: name of the protocol.
        protocol_version: version of the protocol.
        protocol_hash: hash of the protocol.
        dataset: name of the dataset on the board.
        dataset_hash: hash of the tables that the split was made from.
        plan_hash: hash of what was asked: the views, or the scenarios with their seeds and maps; None: it is not known.
        split: split of the dataset.
        options: other options that determine the figures: only entries with equal options are comparable.
        setting: setting that distinguishes rows of one method.
        result_hash: hash of the result.
        toolkit: version of the toolkit that evaluated the submission.
        frames_per_second: images per second, as the submission states it.
        device: processor of ``frames_per_second``.
        figures: means with their confidence intervals.
        clusters: the figure that ranks in each cluster, from which intervals of ranks are computed. The hash of the
            content omits an empty one: the entry was added before they were kept, or the figure is of a whole set.
        pairs: renders beside their truth.
        notes: warnings of the evaluation.
        verified: whether the board's organiser scored the renders again. The hash of the content omits False.
        policy_run: how the board's organiser ran the policy of the rollouts; None: the participant ran it. The hash of
            the content omits None.
        added: day on which the entry was added to the board; None: it is not known.
        seal: hash of all fields above, which reveals changes by hand.
        key: id of the organiser's key that signed the entry (`mirror_leaderboard.keys`).
        signed_on: day of the signature.
        signature: the organiser's signature of the seal and the day, ed25519 in base64; None: the entry is a draft.
    """

    kind: Literal["measured"] = "measured"
    method: Name
    version: Name
    link: Link | None = None
    protocol: str
    protocol_version: int = Field(ge=1)
    protocol_hash: Hash
    dataset: Name
    dataset_hash: Hash
    plan_hash: Hash | None = Field(default=None, exclude_if=lambda plan: plan is None)
    split: Name
    options: dict[Name, Note] = Field(default_factory=dict)
    setting: Name | None = None
    result_hash: Hash
    toolkit: Name
    frames_per_second: Annotated[float, Field(ge=1e-6, le=MOST_FRAMES_PER_SECOND)] | None = None
    device: Name | None = None
    figures: tuple[Figure, ...] = Field(min_length=1)
    clusters: tuple[Cluster, ...] = Field(default=(), exclude_if=lambda clusters: not clusters)
    pairs: tuple[Pair, ...] = ()
    notes: tuple[Note, ...] = ()
    verified: bool = Field(default=False, exclude_if=lambda verified: not verified)
    policy_run: Isolation | None = Field(default=None, exclude_if=lambda run: run is None)
    added: date | None = Field(default=None, exclude_if=lambda added: added is None)
    seal: Hash = "0" * 64
    key: KeyId | None = Field(default=None, exclude_if=lambda key: key is None)
    signed_on: date | None = Field(default=None, exclude_if=lambda day: day is None)
    signature: Signature | None = Field(default=None, exclude_if=lambda signature: signature is None)

    def sealed(self) -> Measured:
        """Return a copy with its seal and without a signature."""
        return self.model_copy(update={"seal": self.content_hash, **dict.fromkeys(_SIGNATURE)})

    @property
    def signed_content(self) -> bytes:
        """The bytes that the organiser signs."""
        return f"mirror-leaderboard-entry {self.seal} {self.signed_on}".encode()

    @property
    def content_hash(self) -> str:
        """The correct value of the seal."""
        plain = self.model_dump(mode="json", exclude={"seal", *_SIGNATURE})
        return hash_document(plain, HashStyle.CANONICAL)


Entry = Reported | Measured


class _File(RootModel[Annotated[Entry, Field(discriminator="kind")]]):
    """The document of a file under ``entries/``."""


def load_entries(folder: Path) -> list[Entry]:
    """Load all entries of a folder, ordered by file name; see `load_entry_files` for the errors."""
    return list(load_entry_files(folder).values())


def load_entry_files(folder: Path) -> dict[Path, Entry]:
    """Load all entries of a folder, by file, ordered by file name.

    Raises:
        DatasetError: the folder does not exist.
        SchemaError: a file is not an entry, names an unknown protocol, was changed after it was added, or repeats
            another entry.
    """
    if not folder.is_dir():
        raise DatasetError("no such folder", file=folder, expected="a folder of entries")
    paths: dict[tuple[str | None, ...], Path] = {}
    entries: dict[Path, Entry] = {}
    for path in sorted(folder.glob("*.json")):
        entry = read_json(path, _File).root
        _require_valid(entry, path)
        first = paths.setdefault(entry_key(entry), path)
        if first is not path:
            raise SchemaError(f"is another entry for the same as {first.name}", file=path, remedy="keep one of them")
        entries[path] = entry
    return entries


def entry_key(entry: Entry) -> tuple[str | None, ...]:
    """Return the key of an entry: a board may have one entry for each key."""
    if isinstance(entry, Reported):
        return (entry.kind, entry.method, entry.protocol, entry.dataset, entry.setting, entry.paper.title)
    return (
        entry.kind,
        entry.method,
        entry.version,
        entry.setting,
        entry.split,
        entry.protocol_hash,
        entry.dataset_hash,
        entry.plan_hash,
    )


def _require_valid(entry: Entry, path: Path) -> None:
    known = protocol_names()
    if entry.protocol not in known:
        raise SchemaError(
            f"unknown protocol {entry.protocol!r}", file=path, place="protocol", expected=f"one of {', '.join(known)}"
        )
    counts = Counter((figure.group, figure.metric) for figure in entry.figures)
    for (group, metric), count in counts.items():
        if count > 1:
            raise SchemaError(
                f"has {metric} of {group} {count} times",
                file=path,
                place="figures",
                remedy="take the entry out of the board, and add its result again",
            )
    if isinstance(entry, Measured) and entry.seal != entry.content_hash:
        raise SchemaError(
            "was changed after it was added: its seal does not match its content",
            file=path,
            place="seal",
            expected=entry.content_hash,
            remedy="remove it and add the result again: mirror leaderboard add result.json --dataset-name NAME",
        )
