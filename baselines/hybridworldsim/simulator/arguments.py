"""The arguments of ``mirror simulate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mirror.command_line import help_text


@dataclass(frozen=True)
class Arguments:
    """Drive a scenario with a policy. --out receives the states, the map, the controls and a video of the cameras.

    A collision ends the drive. The exit code is 1 if the policy failed or was too slow; the states up to there are
    complete. `mirror evaluate RUN --protocol safety` scores the folder.
    """

    out: Annotated[Path, help_text(metavar="RUN")]
    """A new folder; with --suite, also one with drives of the same suite and policy, which are kept."""
    source: Annotated[
        tyro.conf.Positional[str | None],
        help_text(default="required without --suite", metavar="DATASET|synth:PRESET"),
    ] = None
    """Folder or URL of a dataset, or a synthetic street, synth:PRESET[:SEED[:DRIVE]]."""
    model: Annotated[tyro.conf.Positional[Path | None], help_text(default="none", metavar="MODEL")] = None
    """Folder of a model of the scene, which `mirror reconstruct` wrote: it renders the images."""
    scenario: Annotated[str | None, help_text(default="that of --replay", metavar="NAME|FILE.toml")] = None
    """Name of a scenario, or path of its .toml file."""
    policy: Annotated[str | None, help_text(default="the controls of --replay", metavar="NAME|FILE.py:CLASS|...")] = (
        None
    )
    """An installed policy (idm, log, stop, constant-velocity, or another one of the entry points mirror.policies), a
    class in a file, or the address grpc://HOST:PORT of a driver that serves AlpaSim's EgodriverService; the connection
    is not encrypted. With --suite also sandbox:FILE.py:CLASS, sandbox:COMMAND and container:IMAGE: the policy runs
    apart, without network and files of this machine."""
    policy_folder: Annotated[Path | None, help_text(default="that of FILE.py, or none", metavar="FOLDER")] = None
    """With --policy sandbox:...: the files that the policy sees, as /policy."""
    secret: Annotated[Path | None, help_text(default="none", metavar="FILE")] = None
    """With --suite: the organiser's secret, from which the parameters of a test split's scenarios follow."""
    driver: Annotated[Path | None, help_text(default="front_wide as JPEG, 30 s", metavar="FILE.toml")] = None
    """Cameras, lens, image format and deadline of a driver at an address."""
    renderer: Annotated[
        Literal["boxes", "exact", "reconstructed", "generated"] | None,
        help_text(default="that of the generator or the model, exact for a synthetic street, else boxes"),
    ] = None
    """Renderer of the images: wireframes, the synthetic street, a trained model, or one with generated road users."""
    generator: Annotated[Path | None, help_text(default="none", metavar="FOLDER")] = None
    """Generator of road users, which `mirror generate train` wrote, over the street of MODEL. The drive runs at the
    rate of its training."""
    hz: Annotated[float | None, help_text(default="that of the generator's training")] = None
    """With --generator: steps of the drive in a second."""
    sampler_steps: int = 4
    """Steps of the generator's sampler."""
    blend: Annotated[str, help_text(metavar="PIXELS|none")] = "4"
    """Use generated pixels only in the hulls of boxes, grown by this many pixels; elsewhere the street stays. none: use
    them everywhere."""
    fallback: Annotated[Literal["reconstructed"] | None, help_text(default="refuse such a scenario")] = None
    """Renderer of views with agents of a class that the generator does not know."""
    method: Annotated[str | None, help_text(default="the installed one of the model", metavar="FILE.py:OBJECT")] = None
    """The file of MODEL's method, if that is not installed: that of the training."""
    device: Annotated[str | None, help_text(default="auto", metavar="auto|cpu|cuda[:N]")] = None
    """Device of MODEL and the generator. auto: a GPU that torch and gsplat can use, else the CPU. The first
    line says which."""
    scene: Annotated[str | None, help_text(default="the only one", metavar="ID")] = None
    """Scene of the dataset."""
    boxes: Annotated[str | None, help_text(default="the only layer of boxes", metavar="SOURCE@VERSION")] = None
    """The layer of boxes that are the recorded road users: labels of people, or of a version of an annotator."""
    map: Annotated[Path | None, help_text(default="exact, or recorded, or fitted", metavar="FILE")] = None
    """Road map of the scene, as GeoParquet. By default that of the synthetic street; for a dataset its recorded map,
    which `mirror ingest --map` added, or else one that is fitted to the driven lines."""
    cameras: Annotated[str | None, help_text(default="all of the rig", metavar="NAME,...")] = None
    """Cameras of the video. The policy gets the cameras that it asks for."""
    width: int = 240
    """Width of the images."""
    height: Annotated[int | None, help_text(default="in proportion")] = None
    """Height of the images."""
    video: bool = True
    """Write a video of the cameras with a bird's-eye view beside them."""
    report: bool = False
    """Write report.html: the video, curves over its time, events, and the figures of the safety."""
    duration: Annotated[float | None, help_text(default="that of the scenario", metavar="SECONDS")] = None
    """Duration of the drive."""
    seed: Annotated[int | None, help_text(default="that of the scenario")] = None
    """Seed of the rollout."""
    deadline: Annotated[float | None, help_text(default="none", metavar="SECONDS")] = None
    """Longest time that the policy may take for an action."""
    replay: Annotated[Path | None, help_text(default="none", metavar="RUN")] = None
    """Repeat the controls of an earlier rollout on its street, with its scenario and seed, and compare the states."""
    begin: Annotated[Path | None, help_text(name="from", default="none", metavar="RUN")] = None
    """With --at and --policy: go on from an instant of an earlier rollout, on its street, with its scenario and seed.
    Its controls are driven up to there, while the policy observes."""
    at: Annotated[float | None, help_text(default="none", metavar="SECONDS")] = None
    """With --from: the instant from which the policy drives."""
    suite: Annotated[str | None, help_text(default="none", metavar="NAME|FILE.toml")] = None
    """Drive all drives of a protocol with a suite, such as closed-loop; of the options, only --policy, --policy-folder,
    --secret, --out, --workers and --json count. Repeat the command after an interruption."""
    workers: Annotated[int | None, help_text(default="the number of cores")] = None
    """Number of processes of --suite."""
    json: bool = False
    """Print JSON."""
