"""A folder of an organiser's true pictures: what it is of, and whether it is whole."""

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
    """``hidden.json``: what the pictures beside it are the truth of.

    Attributes:
        format: always ``mirror-hidden-truth``.
        version: of this document.
        protocol: name of the protocol.
        protocol_hash: what it said.
        split: name of the split.
        dataset_hash: of what the split was made of.
        plan_hash: of the views that were asked for.
        preset: of the synthetic street that they show.
        seed: of it.
    """

    format: Literal["mirror-hidden-truth"] = "mirror-hidden-truth"
    version: Literal["1.0"] = "1.0"
    protocol: str
    protocol_hash: str
    split: str
    dataset_hash: str
    plan_hash: str
    preset: str
    seed: int


def make_hidden_document(plan: Plan, preset: str, seed: int) -> HiddenDocument:
    """What stands beside the truth of a plan's views."""
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
    """Hold an organiser's folder against a plan: every picture is there, whole and of the view's size.

    A folder without ``hidden.json`` may be of an organiser's own making; its pictures are held against the plan alone.

    Raises:
        UsageError: it is no folder, or its document is of another plan.
        DatasetError: pictures are missing or broken; the first is named, and how many there are.
        SchemaError: its document is broken.
    """
    if not hidden.is_dir():
        raise UsageError("no such folder of hidden truth", file=hidden, place="--hidden")
    document = hidden / HIDDEN
    if document.is_file():
        said = read_json(document, HiddenDocument)
        if said.plan_hash != plan.hash:
            raise UsageError(
                f"the truth of other views: of protocol {said.protocol}, split {said.split}, "
                f"data set {said.dataset_hash[:12]}",
                file=hidden,
                place="--hidden",
                expected=f"protocol {plan.protocol.name}, split {plan.split}, data set {plan.dataset_hash[:12]}",
            )
    wrong = [(view.path, why) for view in plan.views if (why := _problem(hidden, view)) is not None]
    if wrong:
        path, why = wrong[0]
        raise DatasetError(
            f"{len(wrong)} of {len(plan.views)} true pictures are not as expected; the first {why}",
            file=hidden / path,
            place="--hidden",
            expected="the organiser's whole folder of hidden truth",
            remedy="the submission is not at fault: name the folder that `mirror submission hidden` wrote",
        )


def _problem(hidden: Path, view: RenderView) -> str | None:
    try:
        data = (hidden / view.path).read_bytes()
    except FileNotFoundError:
        return "is missing"
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    there = png_size(data)
    if there is not None and there != (view.width_px, view.height_px):
        return f"is {there[0]} x {there[1]} px, not {view.width_px} x {view.height_px} px"
    problem = find_png_problem(data)
    return None if problem is None else f"is broken ({problem})"
