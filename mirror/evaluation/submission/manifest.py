"""``manifest.json`` of a submission: protocol, split, method, appearance and measured costs."""

from __future__ import annotations

import hashlib
from typing import Annotated, Final, Literal

from pydantic import Field, ValidationError

from mirror.evaluation.submission.untrusted import UntrustedError, UntrustedFiles, parse_untrusted
from mirror.schema.documents import Document, is_identifier
from mirror.schema.problems import describe_problem

MANIFEST: Final = "manifest.json"
MAX_MANIFEST_BYTES: Final = 1 << 20
FORMAT_VERSION: Final = "1.1"

_NAME_THEM: Final = "to check the other files nevertheless, give --protocol and --split"

# Names and notes are printed: characters that control a terminal or the direction of text are refused.
_CONTROL_CHARACTERS: Final = r"\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069"
Text = Annotated[str, Field(max_length=2000, pattern=rf"^[^{_CONTROL_CHARACTERS}]*$")]
Word = Annotated[str, Field(min_length=1, max_length=120, pattern=rf"^[^\t\n{_CONTROL_CHARACTERS}]+$")]
Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
MOST_FRAMES_PER_SECOND: Final = 1e6
"""More pixels of the protocols' size than the memory of any processor takes."""


class SubmittedMethod(Document):
    """The method that made the renders, described by its authors.

    Attributes:
        name: name of the method on the leaderboard.
        version: version of the method.
        authors: authors of the method.
        url: address of its code or its description.
        licence: licence of its code.
        trained_on: data that it was trained on besides the split's training traversals.
    """

    name: Word
    version: Word = "1"
    authors: Text = ""
    url: Annotated[str, Field(max_length=400, pattern=r"^(https?://[^\s<>\"']*)?$")] = ""
    licence: Text = ""
    trained_on: Text = ""


class Appearance(Document):
    """The method's choice of appearance for views of traversals that it was not trained on.

    Attributes:
        policy: ``none``: the method has no appearance codes. ``nearest-traversal``, ``mean``, ``zero``: the code of the
            nearest trained traversal, the mean of the trained codes, or a zero vector. ``fitted``: fitted to the
            held-out pixels below. ``other``: see ``description``.
        description: free text.
    """

    policy: Literal["none", "nearest-traversal", "mean", "zero", "fitted", "other"]
    description: Text = ""


LEAST_COSTS: Final = {"model_bytes": 1, "driven_m": 1.0, "training_s": 0.01}
"""Costs below these are not measured: of a method that writes nothing, or of a clock's step."""


class Runtime(Document):
    """Time and memory that the method needs, measured by its authors, within plausible bounds.

    Attributes:
        device: name of the processor.
        frames_per_second: rendered images per second at the protocol's size; opening the model is not counted.
        model_bytes: size of everything that rendering needs, summed over all scenes.
        driven_m: length of the road that the models cover, along the driven line.
        training_s: training time, summed over all scenes.
        peak_memory_bytes: peak memory of rendering.
    """

    device: Word
    frames_per_second: Annotated[float, Field(ge=1e-6, le=MOST_FRAMES_PER_SECOND)] | None = None
    model_bytes: Annotated[int, Field(ge=LEAST_COSTS["model_bytes"], le=10**15)] | None = None
    driven_m: Annotated[float, Field(ge=LEAST_COSTS["driven_m"], le=1e8)] | None = None
    training_s: Annotated[float, Field(ge=LEAST_COSTS["training_s"], le=1e9)] | None = None
    peak_memory_bytes: Annotated[int, Field(ge=10**5, le=10**14)] | None = None


class SubmissionManifest(Document):
    """``manifest.json`` of a submission.

    Attributes:
        format: always ``mirror-submission``.
        version: version of this document.
        protocol: name of the protocol.
        protocol_hash: hash of the protocol.
        split: name of the split.
        dataset_hash: hash of the tables that the split was made from.
        plan_hash: hash of the requested views.
        method: the method that made the renders.
        appearance: how the method chooses the appearance of held-out traversals.
        runtime: time and memory that the method needs; None if not stated.
        seed: seed of the method's random numbers, if it has one.
        notes: free text.
    """

    format: Literal["mirror-submission"] = "mirror-submission"
    version: Literal["1.1"] = "1.1"
    protocol: Word
    protocol_hash: Hash
    split: Word
    dataset_hash: Hash
    plan_hash: Hash
    method: SubmittedMethod
    appearance: Appearance
    runtime: Runtime | None = None
    seed: int | None = None
    notes: Text = ""


def read_protocol_and_split(files: UntrustedFiles, protocol: str | None, split: str | None) -> tuple[str, str]:
    """Return the names of a submission's protocol and split: the given ones, or the ones in its manifest.

    The other keys of the manifest may be wrong.

    Raises:
        UntrustedError: the manifest does not name them, or gives a path as its protocol: a submission must not choose
            the file that it is scored by.
    """
    if protocol is not None and split is not None:
        return protocol, split
    try:
        raw = parse_untrusted(_read_bytes(files), f"{files.where}: {MANIFEST}", MAX_MANIFEST_BYTES)
    except UntrustedError as error:
        remedy = f"{error.remedy}; {_NAME_THEM}" if error.remedy else _NAME_THEM
        raise UntrustedError(
            error.problem, file=error.file, place=error.place, expected=error.expected, remedy=remedy
        ) from error
    stated = [raw.get(key) if isinstance(raw, dict) else None for key in ("protocol", "split")]
    for key, value in zip(("protocol", "split"), stated):
        if not isinstance(value, str) or not is_identifier(value):
            raise UntrustedError(
                f"does not name its {key}",
                file=f"{files.where}: {MANIFEST}",
                remedy=_NAME_THEM,
            )
    return protocol or str(stated[0]), split or str(stated[1])


def read_manifest(files: UntrustedFiles) -> tuple[SubmissionManifest, str]:
    """Read the manifest of a submission.

    Raises:
        UntrustedError: it is missing, too large or not JSON, or a key is wrong; the first five wrong keys are named.
    """
    data = _read_bytes(files)
    raw = parse_untrusted(data, f"{files.where}: {MANIFEST}", MAX_MANIFEST_BYTES)
    try:
        return SubmissionManifest.model_validate(raw), hashlib.sha256(data).hexdigest()
    except (ValidationError, RecursionError) as error:
        details = error.errors() if isinstance(error, ValidationError) else []
        places = [".".join(map(str, item["loc"])) or "document" for item in details[:5]]
        listed = "; ".join(f"{place}: {describe_problem(item)}" for place, item in zip(places, details))
        raise UntrustedError(
            listed or "nested too deep",
            file=f"{files.where}: {MANIFEST}",
            expected="a manifest as docs/submission.md describes it",
        ) from error


def _read_bytes(files: UntrustedFiles) -> bytes:
    if MANIFEST not in files.sizes:
        raise UntrustedError(
            "missing",
            file=f"{files.where}: {MANIFEST}",
            expected="a manifest",
            remedy="`mirror submission new` writes a template",
        )
    return files.read(MANIFEST, MAX_MANIFEST_BYTES)
