"""The folder of the study, and how its stages are run: in order, within the budget, each once.

A stage whose file of figures exists is not run again. Files state the declaration's hash: those of another
declaration are refused. Published outcomes are shown in the report; the files that later stages need are made again.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final, TypeAlias

import torch

from benchmarks.studies.generation.declaration import Declaration
from benchmarks.studies.generation.features import Features, load_features
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.clips.folder import read_clips, read_list
from hybridworldsim.generation.training.autoencoder_trainer import AutoencoderSettings
from hybridworldsim.generation.training.generator_trainer import GeneratorSettings
from mirror.errors import UsageError
from mirror.progress import ProgressReporter
from mirror.schema.files import write_bytes

Figures: TypeAlias = dict[str, Any]
OUTCOMES: Final = Path(__file__).with_name("outcomes.jsonl")


@dataclass(frozen=True)
class Outcome:
    """The processor time of a stage in seconds, and its figures."""

    core_s: float
    figures: Figures


@dataclass
class Study:
    """The folder of a study with the data that its stages share.

    Attributes:
        folder: the folder.
        declaration: what was declared.
        make_clips: makes the clips of a folder; resumable.
        network: settings of the generators' training; the declaration's values replace some.
        autoencoder_settings: of the autoencoder's training.
        load: the features of images.
        judge_steps: steps of the judges' training; None: their own.
        published: outcomes that were published, perhaps on another machine; the report shows them.
        trained: folder of the study whose models and judges are used; None: this one.
    """

    folder: Path
    declaration: Declaration
    make_clips: Callable[[Path, ProgressReporter], object]
    network: GeneratorSettings = field(default_factory=GeneratorSettings)
    autoencoder_settings: AutoencoderSettings = field(default_factory=AutoencoderSettings)
    load: Callable[[], Features] = load_features
    judge_steps: dict[str, int] | None = None
    published: Path = OUTCOMES
    trained: Path | None = None

    @property
    def references(self) -> int:
        """T, number of reference frames, which are never scored."""
        return self.network.references

    @property
    def clips(self) -> Path:
        """Folder of the clips."""
        return self.folder / "clips"

    @cached_property
    def test(self) -> list[Clip]:
        """The test clips."""
        return read_clips(self.clips, read_list(self.clips).test)

    @cached_property
    def features(self) -> Features:
        """The features of images."""
        return self.load()

    @property
    def drives(self) -> dict[str, str]:
        """Drive of each test clip."""
        return {clip.clip_id: clip.drive_id for clip in self.test}

    @property
    def autoencoder(self) -> Path:
        """The autoencoder of all models: that of the first training."""
        return (self.trained or self.folder) / "models" / "on-0" / "autoencoder" / "model.safetensors"

    @property
    def judges(self) -> Path:
        """Folder of the judges."""
        return (self.trained or self.folder) / "judges"

    def model(self, name: str) -> Path:
        """Return the file of a generator."""
        return (self.trained or self.folder) / "models" / name / "generator" / "model.safetensors"

    def figures(self, stage: str) -> Figures | None:
        """Return the figures of a stage that is finished in this folder; None: it is not.

        Raises:
            UsageError: the stage was run under another declaration.
        """
        path = self.folder / "figures" / f"{stage}.json"
        return dict(self._read(path)["figures"]) if path.is_file() else None

    @cached_property
    def outcomes(self) -> dict[str, Outcome]:
        """Outcomes of this folder, and the published ones of this declaration that it lacks, by stage."""
        rows = (
            [json.loads(line) for line in self.published.read_text().splitlines()] if self.published.is_file() else []
        )
        found = {row["stage"]: row for row in rows if row["declaration"] == self.declaration.hash}
        for path in sorted((self.folder / "figures").glob("*.json")):
            found[path.stem] = {"stage": path.stem, **self._read(path)}
        return {
            stage: Outcome(row["core_s"], _replaced(row["figures"], _nan_unless_finite)) for stage, row in found.items()
        }

    def shown(self, stage: str) -> Figures | None:
        """Return the figures of a stage, finished here or published; None: there are none."""
        outcome = self.outcomes.get(stage)
        return None if outcome is None else outcome.figures

    def publish(self) -> Path:
        """Write all outcomes as lines of JSON, and return the file; numbers that are not finite are null."""
        rows = [
            {"stage": stage, "declaration": self.declaration.hash, **_replaced(asdict(outcome), _finite)}
            for stage, outcome in sorted(self.outcomes.items())
        ]
        write_bytes(self.published, "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows).encode())
        return self.published

    def finish(self, stage: str, core_s: float, figures: Figures) -> None:
        """Write the figures of a stage."""
        document = {"declaration": self.declaration.hash, "core_s": core_s, "figures": figures}
        write_bytes(self.folder / "figures" / f"{stage}.json", json.dumps(document, indent=1).encode())
        self.__dict__.pop("outcomes", None)

    def used_core_s(self) -> float:
        """Return the processor time of the stages that are finished in this folder."""
        return sum(float(self._read(path)["core_s"]) for path in sorted((self.folder / "figures").glob("*.json")))

    def is_void(self) -> bool:
        """Return whether the comparison of conditioning is void: the off model does not beat a copy of the last frame.

        The frames are generated from recorded ones, as the copy is.
        """
        figures = self.shown(f"score-off-{self.declaration.training['seeds'][0]}")
        return figures is not None and figures["next_db"] <= self.declaration.bars["off_background_db"]

    def _read(self, path: Path) -> dict[str, Any]:
        document: dict[str, Any] = json.loads(path.read_text())
        if document["declaration"] != self.declaration.hash:
            raise UsageError(
                f"made under the declaration {document['declaration'][:12]}, not {self.declaration.hash[:12]}",
                file=path,
                remedy="choose another --out",
            )
        return document


def _replaced(value: Any, replace_one: Callable[[Any], Any]) -> Any:
    """A value of JSON with each of its numbers, strings and nulls replaced."""
    if isinstance(value, dict):
        return {name: _replaced(one, replace_one) for name, one in value.items()}
    if isinstance(value, list):
        return [_replaced(one, replace_one) for one in value]
    return replace_one(value)


def _finite(value: Any) -> Any:
    """Null for a number that is not finite, which JSON does not have."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _nan_unless_finite(value: Any) -> Any:
    """NaN for null and for a number that is not finite, so that a folder and what was published of it show the same."""
    return math.nan if _finite(value) is None else value


@dataclass(frozen=True)
class Stage:
    """A part of the study.

    Attributes:
        name: its name.
        core_minutes: its budget, from measured costs.
        run: does it, and returns its figures.
    """

    name: str
    core_minutes: float
    run: Callable[[Study, ProgressReporter], Figures]


def run_stages(
    study: Study,
    stages: Sequence[Stage],
    progress: ProgressReporter,
    *,
    only: str | None = None,
    hours: float | None = None,
) -> int:
    """Run the stages that are not finished, until the budget is used up.

    Args:
        study: the study.
        stages: all stages in their order.
        progress: receives the progress.
        only: name of one stage; None: all.
        hours: core-hours after which no stage is begun, those of finished stages included; None: the declaration's.

    Returns:
        The number of stages that are left.

    Raises:
        UsageError: there is no such stage.
    """
    if only is not None and only not in {stage.name for stage in stages}:
        raise UsageError(f"no stage {only!r}", expected=", ".join(stage.name for stage in stages))
    if only not in ("clips", "judges"):
        # Missing weights are named before minutes are spent.
        _ = study.features
    budget_s = 3600.0 * (study.declaration.budget["core_hours"] if hours is None else hours)
    torch.set_num_threads(int(study.declaration.training["threads"]))
    left = 0
    for stage in stages:
        if study.figures(stage.name) is not None:
            continue
        if only is not None and stage.name != only:
            left += 1
            continue
        if study.used_core_s() + 60.0 * stage.core_minutes > budget_s:
            progress.message(f"{stage.name}: {stage.core_minutes:g} core-minutes are more than is left of the budget")
            # Later stages need this one.
            return sum(study.figures(one.name) is None for one in stages)
        progress.message(f"{stage.name}: about {stage.core_minutes:g} core-minutes")
        begin = time.process_time()
        figures = stage.run(study, progress)
        # An interrupted training counts its earlier parts itself.
        core_s = float(figures.pop("core_s", time.process_time() - begin))
        study.finish(stage.name, core_s, figures)
    return left
