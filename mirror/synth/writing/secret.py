"""``secret.json`` beside recordings of a secret seed: the seed, which stays with the organiser."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated, Final, Literal, NamedTuple

from pydantic import Field

from mirror.errors import DatasetError, UsageError
from mirror.schema.documents import Document
from mirror.schema.files import TEMPORARY, read_json, unwritable_error
from mirror.synth.seeds import pack_secret_seed, parse_public_seed, unpack_secret_seed
from mirror.synth.writing.journal import SECRET_SEED, SYNTH, SynthDocument

SECRET: Final = "secret.json"
_OWNER_ONLY: Final = 0o600


class SecretDocument(Document):
    """``secret.json``; only its owner may read it.

    Attributes:
        format: always ``mirror-synth-secret``.
        version: version of this document's format.
        note: a warning to readers.
        seed: the 128 random bits of the secret seed, hexadecimal.
    """

    format: Literal["mirror-synth-secret"] = "mirror-synth-secret"
    version: Literal["1.0"] = "1.0"
    note: str = "Do not publish this file: whoever has it can render every image of these recordings."
    seed: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]


class RecordedSeed(NamedTuple):
    """Origin of recordings of the synthetic street.

    Attributes:
        preset: preset of the recordings.
        seed: public or secret seed.
    """

    preset: str
    seed: int


def write_secret(out: Path, seed: int) -> None:
    """Write a secret seed beside recordings, readable for its owner alone from the first byte on.

    Raises:
        DatasetError: the folder is not writable; a previous file is unchanged.
    """
    document = SecretDocument(seed=pack_secret_seed(seed))
    data = (json.dumps(document.model_dump(mode="json"), indent=1) + "\n").encode()
    path = out / SECRET
    temporary = out / f".{SECRET}.{os.getpid()}{TEMPORARY}"
    try:
        out.mkdir(parents=True, exist_ok=True)
        with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, _OWNER_ONLY), "wb") as file:
            file.write(data)
        temporary.replace(path)
    except OSError as error:
        raise unwritable_error(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def read_secret(out: Path) -> int:
    """Read the secret seed of recordings.

    Raises:
        DatasetError: the file is missing.
        SchemaError: the file is invalid.
    """
    if not (out / SECRET).is_file():
        raise DatasetError(
            "the secret seed of these recordings is missing",
            file=out / SECRET,
            expected="the file that `mirror synth --secret` wrote",
            remedy="restore it from a copy: without it the recordings can be neither continued nor rendered again",
        )
    return unpack_secret_seed(read_json(out / SECRET, SecretDocument).seed)


def read_recorded_seed(recordings: Path, place: str) -> RecordedSeed:
    """Read preset and seed of a folder of recordings that ``mirror synth`` wrote.

    Args:
        recordings: the folder with ``synth.json``.
        place: the option that names the folder, for messages.

    Raises:
        UsageError: the folder does not exist, or `mirror synth` did not write it.
        DatasetError: the secret seed is missing.
        SchemaError: a document is invalid.
    """
    if not (recordings / SYNTH).is_file():
        raise UsageError(
            f"no {SYNTH} in this folder", file=recordings, place=place, expected="the --out folder of `mirror synth`"
        )
    arguments = read_json(recordings / SYNTH, SynthDocument).arguments
    seed = arguments.get("seed", "")
    if "rolling_shutter" in arguments:
        raise UsageError(
            f"recordings with rolling shutters ({arguments['rolling_shutter']})",
            file=recordings,
            place=place,
            expected="global ones: hidden truth is rendered at one instant",
        )
    if seed == SECRET_SEED:
        return RecordedSeed(arguments.get("preset", ""), read_secret(recordings))
    return RecordedSeed(arguments.get("preset", ""), parse_public_seed(seed, f"{SYNTH}, arguments.seed"))
