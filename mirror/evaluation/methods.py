"""Methods that are installed here, through the entry points ``mirror.methods``, and how fast they render.

Nothing of a submission is run: who evaluates names the method, and has installed it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Final, Protocol

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.evaluation import protocol as protocols
from mirror.evaluation.progress import Watch
from mirror.evaluation.submission.manifest import Rectangle
from mirror.evaluation.training import Picture
from mirror.evaluation.views.plan import Plan
from mirror.evaluation.views.view import View

GROUP: Final = "mirror.methods"
FITTED_PART: Final = Rectangle(left=0.0, top=0.0, right=0.5, bottom=1.0)
"""Of a held-out picture: what looks may be fitted to. It is not scored then."""

_WARM_UP: Final = 3
_LEAST_S: Final = 5.0
_MOST_VIEWS: Final = 500


@dataclass(frozen=True)
class Task:
    """What is to be reconstructed, and for how long.

    Attributes:
        scene: id.
        split: name; only its training traversals are looked at.
        protocol: whose raster and masks hold; pictures are no wider than it says.
        steps: pictures to train on; or None.
        core_minutes: processor time to train for, in each block; or None.
        seed: of all that is left to chance.
        initialise: where depth and points come from: an estimator's name, ``dataset`` for layers that were brought, or
            one of them, ``source@version``. None: those that were brought, if there are and nothing is withheld;
            else the method's own estimator.
        threads: None: as many as the method takes by itself.
        half: write the model in half precision.
        withheld: pictures of training traversals that are not looked at, such as
            `mirror.evaluation.training.asked_of_training` names.
        blocks: names of those that are trained now, for any executor to share out; none: all.
        settings: of the method, by name, in place of its own; as text.
    """

    scene: str
    split: str
    protocol: protocols.Protocol
    steps: int | None = None
    core_minutes: float | None = None
    seed: int = 0
    initialise: str | None = None
    threads: int | None = None
    half: bool = False
    withheld: frozenset[Picture] = field(default=frozenset())
    blocks: frozenset[str] = field(default=frozenset())
    settings: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Reconstructed:
    """What came of it.

    Attributes:
        folder: of the model.
        blocks: folders in it that are trained, in order.
        psnr_db: of the pictures that were trained on last, mean of the blocks.
        steps: pictures that were learnt from, of all blocks.
        core_s: processor time of training.
        wall_s: time on the wall, of training.
        gaussians: held.
        model_bytes: of all that rendering needs.
        pictures: that were trained on.
        driven_m: length of the road that the model covers.
        undone: blocks that are still to be trained, see `Task.blocks`; the figures are of the others.
        points: layer of points that it began with, ``source@version``; None: it began without.
    """

    folder: Path
    blocks: tuple[str, ...]
    psnr_db: float
    steps: int
    core_s: float
    wall_s: float
    gaussians: int
    model_bytes: int
    pictures: int
    driven_m: float
    undone: tuple[str, ...] = ()
    points: str | None = None


@dataclass(frozen=True)
class Looking:
    """How pictures shall look of traversals and cameras that were not trained on.

    Attributes:
        policy: ``nearest``, ``mean``, ``fit``, a traversal, a word of light or weather, or ``sweep:A:B``.
        views: all that will be rendered, so that whole lines can be compared.
        everywhere: the policy holds for what was trained on too: the light of a recorded traversal is edited.
        truth: for ``fit`` alone: the dataset and the plan whose pictures may be looked at, in their left half.
    """

    policy: str = "nearest"
    views: Sequence[View] = ()
    everywhere: bool = False
    truth: tuple[Dataset, Plan] | None = None


class InstalledMethod(Protocol):
    """What an entry point names."""

    def reconstruct(self, dataset: Dataset, task: Task, out: Path, watch: Watch) -> Reconstructed:
        """Train a model, or go on where an earlier call was stopped.

        Args:
            dataset: where the pictures lie.
            task: what is asked.
            out: folder of the model; another task's is refused.
            watch: told how it goes.
        """

    def open(self, model: Path, looking: Looking = ...) -> Callable[[View], UInt8]:
        """A renderer of a trained model: pixels (H, W, 3), RGB, of a view."""


def installed_method(name: str) -> InstalledMethod:
    """A method that is installed.

    Raises:
        UsageError: there is none of that name, or what it needs is not installed.
    """
    found = {entry.name: entry for entry in entry_points(group=GROUP)}
    if name not in found:
        listed = ", ".join(sorted(found)) or "none is installed"
        raise UsageError(f"no method {name!r} is installed", expected=f"an entry point {GROUP}: {listed}")
    try:
        method: InstalledMethod = found[name].load()
    except ModuleNotFoundError as error:
        raise UsageError(
            f"method {name!r} needs {error.name}, which is not installed",
            place=f"entry point {found[name].value}",
            remedy="install it: pip install 'mirror-dataset[models]', for rivals 'mirror-dataset[baselines]'",
        ) from error
    return method


def licence_of(name: str) -> str:
    """Of the package that an installed method is in, as it says; empty if it does not."""
    for entry in entry_points(group=GROUP):
        if entry.name == name and entry.dist is not None:
            about = entry.dist.metadata
            return str(about["License-Expression"] or about["License"] or "")
    return ""


def by_camera(policies: str, cameras: Sequence[str]) -> dict[str, str]:
    """The policy of looks of each camera.

    Args:
        policies: one for all, or ``CAMERA=POLICY`` for some of them, separated by commas; the others keep their look.
        cameras: that there are.

    Raises:
        UsageError: a camera that there is not, or none is named.
    """
    if "=" not in policies:
        return dict.fromkeys(cameras, policies)
    named = [part.partition("=")[::2] for part in policies.split(",")]
    unknown = [camera for camera, policy in named if camera not in cameras or not policy]
    if unknown:
        raise UsageError(
            f"{policies!r}", place="--appearance", expected=f"CAMERA=LOOK,... of {', '.join(cameras)}"
        )  # fmt: skip
    return {**dict.fromkeys(cameras, Looking().policy), **dict(named)}


def opened_by_camera(
    method: InstalledMethod, model: Path, looking: Looking, policies: Mapping[str, str]
) -> Callable[[View], UInt8]:
    """A renderer of views whose cameras have policies of their own."""
    renderers = {one: method.open(model, replace(looking, policy=one)) for one in dict.fromkeys(policies.values())}
    return lambda view: renderers[policies[view.camera]](view)


def frames_per_second(render: Callable[[View], UInt8], views: Sequence[View]) -> tuple[float, int]:
    """How many pictures a second a renderer makes, one after the other, and of how many that is.

    The first three warm it up; then views are rendered for five seconds at least, in their order and from the first
    again.

    Args:
        render: the renderer.
        views: what it is asked for; not empty.

    Raises:
        UsageError: a picture is not of the size that was asked for.
    """
    for place in range(_WARM_UP):
        view = views[place % len(views)]
        picture = render(view)
        if picture.shape != (view.height_px, view.width_px, 3):
            raise UsageError(
                f"a render of shape {picture.shape}", expected=f"{(view.height_px, view.width_px, 3)}", place=view.path
            )
    begin, count, taken = time.perf_counter(), 0, 0.0
    while taken < _LEAST_S and count < _MOST_VIEWS:
        render(views[count % len(views)])
        count += 1
        taken = time.perf_counter() - begin
    return count / taken, count
