"""A folder of hidden truth: the true images that only the organiser has, and the document that identifies them."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

from mirror.errors import DatasetError, UsageError
from mirror.protocols.png import find_png_problem, png_size
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView
from mirror.schema.documents import Document
from mirror.schema.files import read_json

HIDDEN: Final = "hidden.json"


class HiddenDocument(Document):
    """``hidden.json``: identifies the views that the images beside it are the truth of.

    Attributes:
        format: always ``mirror-hidden-truth``.
        version: version of this document's format.
        protocol: name of the protocol.
        protocol_hash: hash of the protocol.
        split: name of the split.
        dataset_hash: hash of the dataset that the split was made from.
        plan_hash: hash of the plan, that is of the requested views.
        preset: preset of the synthetic street that was rendered.
        seed: public seed of the synthetic street; None: it has a secret seed.
    """

    format: Literal["mirror-hidden-truth"] = "mirror-hidden-truth"
    version: Literal["1.0"] = "1.0"
    protocol: str
    protocol_hash: str
    split: str
    dataset_hash: str
    plan_hash: str
    preset: str
    seed: int | None


def make_hidden_document(plan: Plan, preset: str, seed: int | None) -> HiddenDocument:
    """Make the document that identifies the hidden truth of a plan."""
    return HiddenDocument(
        protocol=plan.protocol.name,
        protocol_hash=plan.protocol.hash,
        split=plan.split,
        dataset_hash=plan.dataset_hash,
        plan_hash=plan.hash,
        preset=preset,
        seed=seed,
    )


def require_hidden_truth(hidden: Path, plan: Plan) -> None:
    """Check a folder of hidden truth against a plan: every image exists, is undamaged and has the size of its view.

    A folder without ``hidden.json`` (made by other means than ``mirror submission hidden``) is accepted if its images
    fit the plan.

    Raises:
        UsageError: the folder does not exist, or its document identifies another plan.
        DatasetError: images are missing or damaged; the message names the first one and their number.
        SchemaError: the document is invalid.
    """
    if not hidden.is_dir():
        raise UsageError(
            "no such folder of hidden truth",
            file=hidden,
            place="--hidden",
            remedy="name another folder with --hidden; for a synthetic street, `mirror submission hidden` renders it",
        )
    document = hidden / HIDDEN
    if document.is_file():
        stored = read_json(document, HiddenDocument)
        if stored.plan_hash != plan.hash:
            raise UsageError(
                f"the folder has the truth of other views: protocol {stored.protocol}, split {stored.split}, "
                f"dataset {stored.dataset_hash[:12]}",
                file=hidden,
                place="--hidden",
                expected=f"protocol {plan.protocol.name}, split {plan.split}, dataset {plan.dataset_hash[:12]}",
            )
    problems = [(view.path, problem) for view in plan.views if (problem := _find_problem(hidden, view)) is not None]
    if problems:
        path, problem = problems[0]
        raise DatasetError(
            f"{len(problems)} of {len(plan.views)} true images are missing or invalid; the first {problem}",
            file=hidden / path,
            place="--hidden",
            expected="the organiser's complete folder of hidden truth",
            remedy="the submission is not at fault: name the folder that `mirror submission hidden` wrote",
        )


def _find_problem(hidden: Path, view: RenderView) -> str | None:
    try:
        data = (hidden / view.path).read_bytes()
    except FileNotFoundError:
        return "is missing"
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    size = png_size(data)
    if size is not None and size != (view.width_px, view.height_px):
        return f"is {size[0]} x {size[1]} px, not {view.width_px} x {view.height_px} px"
    problem = find_png_problem(data)
    return None if problem is None else f"is damaged ({problem})"
