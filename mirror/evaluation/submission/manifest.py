"""``manifest.json`` of a submission: what it answers, by which method, and what the method was shown."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

from pydantic import Field, ValidationError, model_validator

from mirror.evaluation.submission.untrusted import UntrustedError, UntrustedFiles, parse_untrusted
from mirror.protocols.rectangle import Rectangle
from mirror.schema.documents import Document, is_identifier

MANIFEST: Final = "manifest.json"
MAX_MANIFEST_BYTES: Final = 1 << 20
FORMAT_VERSION: Final = "1.0"

_NAME_THEM: Final = "to have the rest checked all the same, name --protocol and --split"

# Names and notes are printed: what steers a terminal, or turns the direction of text, has no place in them.
_STEERING: Final = r"\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069"
Text = Annotated[str, Field(max_length=2000, pattern=rf"^[^{_STEERING}]*$")]
Word = Annotated[str, Field(min_length=1, max_length=120, pattern=rf"^[^\t\n{_STEERING}]+$")]
Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Figure = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Method(Document):
    """Who made the renders.

    Attributes:
        name: of the method, as it stands on the board.
        version: of it.
        authors: whose it is.
        url: where more is said, or its code lies.
        licence: of its code.
        trained_on: what it was trained on besides the split's training traversals.
    """

    name: Word
    version: Word = "1"
    authors: Text = ""
    url: Annotated[str, Field(max_length=400, pattern=r"^(https?://[^\s<>\"']*)?$")] = ""
    licence: Text = ""
    trained_on: Text = ""


class Appearance(Document):
    """How pictures of traversals that were not trained on get their look.

    Attributes:
        policy: ``none``: the method knows no looks. ``nearest-traversal``, ``mean``, ``zero``: of the trained looks.
            ``fitted``: to the held-out pixels below. ``other``: as the description says.
        description: in words.
        held_out_pixels: parts of held-out pictures that the look was fitted to; they are not scored.
    """

    policy: Literal["none", "nearest-traversal", "mean", "zero", "fitted", "other"]
    description: Text = ""
    held_out_pixels: Annotated[tuple[Rectangle, ...], Field(max_length=16)] = ()

    @model_validator(mode="after")
    def _said(self) -> Appearance:
        if self.policy == "fitted" and not self.held_out_pixels:
            raise ValueError("a fitted appearance says which held_out_pixels it was fitted to")
        return self


class Runtime(Document):
    """What the method costs, as its authors measured it.

    Attributes:
        device: the processor.
        frames_per_second: pictures a second at the protocol's size, once the model is open.
        model_bytes: of everything that rendering needs, of all scenes together.
        driven_m: length of the road that the models cover, along the driven line.
        training_s: of all scenes together.
        peak_memory_bytes: of rendering.
    """

    device: Word
    frames_per_second: Figure | None = None
    model_bytes: Annotated[int, Field(gt=0)] | None = None
    driven_m: Figure | None = None
    training_s: Figure | None = None
    peak_memory_bytes: Annotated[int, Field(gt=0)] | None = None


class SubmissionManifest(Document):
    """``manifest.json``.

    Attributes:
        format: always ``mirror-submission``.
        version: of this document.
        protocol: name of the protocol.
        protocol_hash: what it said.
        split: name of the split.
        dataset_hash: of what the split was made of.
        plan_hash: of the views that were asked for.
        method: who made it.
        appearance: how held-out traversals get their look.
        runtime: what it costs; None: not said.
        seed: of what is left to chance, if the method has one.
        notes: anything else.
    """

    format: Literal["mirror-submission"] = "mirror-submission"
    version: Literal["1.0"] = "1.0"
    protocol: Word
    protocol_hash: Hash
    split: Word
    dataset_hash: Hash
    plan_hash: Hash
    method: Method
    appearance: Appearance
    runtime: Runtime | None = None
    seed: int | None = None
    notes: Text = ""


def read_protocol_and_split(files: UntrustedFiles, protocol: str | None, split: str | None) -> tuple[str, str]:
    """Names of the protocol and split of a submission: as given, or as its manifest says, be the rest of it wrong.

    Raises:
        UntrustedError: it does not say, or names a file as its protocol, which its author would choose.
    """
    if protocol is not None and split is not None:
        return protocol, split
    try:
        raw = _raw(files)
    except UntrustedError as error:
        remedy = f"{error.remedy}; {_NAME_THEM}" if error.remedy else _NAME_THEM
        raise UntrustedError(
            error.problem, file=error.file, place=error.place, expected=error.expected, remedy=remedy
        ) from error
    said = [raw.get(key) if isinstance(raw, dict) else None for key in ("protocol", "split")]
    for key, value in zip(("protocol", "split"), said):
        if not isinstance(value, str) or not is_identifier(value):
            raise UntrustedError(
                f"does not say its {key}",
                file=f"{files.where}: {MANIFEST}",
                remedy=_NAME_THEM,
            )
    return protocol or str(said[0]), split or str(said[1])


def read_manifest(files: UntrustedFiles) -> SubmissionManifest:
    """The manifest of a submission.

    Raises:
        UntrustedError: it is missing, too large, no JSON, or a key is wrong; the first is named, and how many more.
    """
    raw = _raw(files)
    try:
        return SubmissionManifest.model_validate(raw)
    except (ValidationError, RecursionError) as error:
        found = error.errors() if isinstance(error, ValidationError) else []
        listed = "; ".join(f"{'.'.join(map(str, one['loc'])) or 'document'}: {one['msg']}" for one in found[:5])
        raise UntrustedError(
            listed or "nested too deep",
            file=f"{files.where}: {MANIFEST}",
            expected="a manifest as docs/submission.md describes it",
        ) from error


def _raw(files: UntrustedFiles) -> Any:
    place = f"{files.where}: {MANIFEST}"
    if MANIFEST not in files.sizes:
        raise UntrustedError(
            "missing", file=place, expected="a manifest", remedy="`mirror submission new` writes a template"
        )
    return parse_untrusted(files.read(MANIFEST, MAX_MANIFEST_BYTES), place, MAX_MANIFEST_BYTES)
