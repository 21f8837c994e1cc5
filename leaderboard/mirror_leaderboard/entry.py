"""Entries: what stands on the board, one JSON each."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, RootModel, model_validator

from mirror.errors import DatasetError, SchemaError
from mirror.protocols.document import protocol_names
from mirror.schema.documents import Document
from mirror.schema.files import read_json, sha256_bytes
from mirror_leaderboard.measures import MEASURES

ALL: Final = "all"
"""The group of figures that are of all groups together, or of no group that a protocol has."""

IMAGE_FOLDER: Final = "pictures"
"""Folder of pictures, beside that of the entries and in the site."""

Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Name = Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[^\x00-\x1f\x7f<>]+$")]
Note = Annotated[str, Field(max_length=400, pattern=r"^[^\x00-\x1f\x7f]+$")]
ImageFile = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_\-]{0,79}(/[a-z0-9][a-z0-9_\-]{0,79})?\.jpg$")]
Link = Annotated[str, Field(max_length=200, pattern=r"^https://[A-Za-z0-9.\-]+(/[A-Za-z0-9._~/%\-]*)?$")]


class Figure(Document):
    """One figure of one group of renders.

    Attributes:
        group: of the protocol; ``all``: of everything.
        metric: what, of `MEASURES`.
        value: in the measure's own unit; None: there is none, and ``note`` says why.
        low: of the confidence interval.
        high: of the confidence interval.
        n: how many pictures, clips or boxes it is of.
        n_missing: of those, how many have no value, such as pictures without a pixel that is scored.
        n_infinite: pictures that equal the truth: their PSNR is infinite, and they are not in ``value``.
        note: what else is to be said.
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
        if measure is None:
            raise ValueError(f"metric {self.metric!r} is not known to the board")
        if self.value is None:
            if not self.note:
                raise ValueError(f"{self.metric} of {self.group} has no value and no note that says why")
            return self
        if not measure.low <= self.value <= measure.high:
            raise ValueError(f"{self.metric} {self.value:g} lies outside {measure.low:g} to {measure.high:g}")
        if (self.low is None) != (self.high is None):
            raise ValueError(f"{self.metric} of {self.group} has half a confidence interval")
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError(f"the interval of {self.metric} of {self.group} ends before it begins")
        return self


class Paper(Document):
    """Where a reported figure stands.

    Attributes:
        title: of the paper.
        table: its number as LaTeX counts.
        label: of the table in the paper's source.
        row: what the paper calls the method.
        about: what the figures are of, in the table's own words.
    """

    title: str
    table: int = Field(ge=1)
    label: str
    row: str
    about: Note


class Reported(Document):
    """Figures that a paper states; nothing of them was run here.

    Attributes:
        kind: tag.
        method: the method's name.
        link: its home.
        protocol: that the figures come nearest to.
        dataset: of the figures; None: the paper does not say.
        setting: what else tells rows of one method apart.
        paper: where they stand.
        figures: as printed.
        notes: what a reader must know before comparing.
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


class Pair(Document):
    """One view of a method beside its truth.

    Attributes:
        view: what is seen: scene, camera, condition.
        render: file of the render, relative to the folder of pictures.
        truth: file of the recorded picture.
    """

    view: Name
    render: ImageFile
    truth: ImageFile


class Measured(Document):
    """Figures that an evaluation found; written by ``mirror leaderboard add``.

    Attributes:
        kind: tag.
        method: the method's name.
        version: of the method.
        link: its home.
        protocol: by which it was scored.
        protocol_version: of the protocol.
        protocol_hash: what the protocol said.
        dataset: what the data set is called here.
        dataset_hash: of what the split was made of.
        split: of the data set.
        options: what else decides the figures: only entries with the same ones are comparable.
        setting: what else tells rows of one method apart.
        result_hash: of the result that the figures are from.
        toolkit: version that measured.
        frames_per_second: pictures a second, as the submission states it or as it was measured again.
        device: on which.
        figures: means over all that the protocol averages, with their intervals.
        pairs: pictures to look at.
        notes: warnings of the evaluation.
        seal: hash of all the rest, so that no figure is changed by hand unnoticed.
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
    split: Name
    options: dict[Name, Note] = Field(default_factory=dict)
    setting: Name | None = None
    result_hash: Hash
    toolkit: Name
    frames_per_second: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    device: Name | None = None
    figures: tuple[Figure, ...] = Field(min_length=1)
    pairs: tuple[Pair, ...] = ()
    notes: tuple[Note, ...] = ()
    seal: Hash = "0" * 64

    def sealed(self) -> Measured:
        """The same with its own seal."""
        return self.model_copy(update={"seal": self.content_hash})

    @property
    def content_hash(self) -> str:
        """What the seal must be."""
        plain = self.model_dump(mode="json", exclude={"seal"})
        return sha256_bytes(json.dumps(plain, sort_keys=True, separators=(",", ":")).encode())


Entry = Reported | Measured


class _File(RootModel[Annotated[Entry, Field(discriminator="kind")]]):
    """What a file under ``entries/`` holds."""


def load_entries(folder: Path) -> list[Entry]:
    """All entries of a folder, in order of their file names.

    Raises:
        DatasetError: there is no such folder.
        SchemaError: a file is no entry, names an unknown protocol, was changed after it was added, or stands for the
            same as another; it is named.
    """
    if not folder.is_dir():
        raise DatasetError("no such folder", file=folder, expected="a folder of entries")
    found: dict[tuple[str | None, ...], Path] = {}
    entries: list[Entry] = []
    for path in sorted(folder.glob("*.json")):
        entry = read_json(path, _File).root
        _require_sound(entry, path)
        same = found.setdefault(entry_key(entry), path)
        if same is not path:
            raise SchemaError(f"stands for the same as {same.name}", file=path, remedy="keep one of them")
        entries.append(entry)
    return entries


def entry_key(entry: Entry) -> tuple[str | None, ...]:
    """What there may be one entry of."""
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
    )


def _require_sound(entry: Entry, path: Path) -> None:
    known = protocol_names()
    if entry.protocol not in known:
        raise SchemaError(
            f"unknown protocol {entry.protocol!r}", file=path, place="protocol", expected=f"one of {', '.join(known)}"
        )
    repeated = [key for key, times in Counter((one.group, one.metric) for one in entry.figures).items() if times > 1]
    if repeated:
        raise SchemaError(f"{repeated[0][1]} of {repeated[0][0]} is there twice", file=path, place="figures")
    if isinstance(entry, Measured) and entry.seal != entry.content_hash:
        raise SchemaError(
            "was changed after it was added: its seal does not fit what it says",
            file=path,
            place="seal",
            expected=entry.content_hash,
            remedy="remove it and add the result again: mirror leaderboard add result.json --dataset-name NAME",
        )
