"""The documents of a run that trains an autoencoder or a generator: ``run.json`` and ``outcome.json``."""

from __future__ import annotations

from typing import Any, Literal

from hybridworldsim.training.run.document import Computation
from mirror.schema.documents import Document


class GenerationRun(Document):
    """``run.json``: everything that determines the result of a run.

    Attributes:
        format: always ``mirror-generation-run``.
        version: version of this document.
        part: what is trained, such as ``autoencoder`` or ``generator``.
        settings: settings of the training.
        seed: seed of all random numbers.
        steps: number of steps.
        threads: number of torch threads; results repeat exactly with the same number.
        processes: number of processes.
        clips_hash: hash of the clips.
        autoencoder_hash: hash of the autoencoder's file, or None for an autoencoder.
        computed: what it computes with; None in runs of version 0.1.0.
    """

    format: Literal["mirror-generation-run"] = "mirror-generation-run"
    version: Literal["1"] = "1"
    part: str
    settings: dict[str, Any]
    seed: int
    steps: int
    threads: int
    processes: int
    clips_hash: str
    autoencoder_hash: str | None
    computed: Computation | None = None


class GenerationOutcome(Document):
    """``outcome.json``: the result of a finished run.

    Attributes:
        steps: number of steps.
        core_s: processor time of training.
        wall_s: wall time of training.
        loss: mean loss of the last fortieth of the steps.
        model_bytes: size of ``model.safetensors``.
        psnr_db: PSNR of reconstructed images, for an autoencoder.
    """

    steps: int
    core_s: float
    wall_s: float
    loss: float
    model_bytes: int
    psnr_db: float | None = None
