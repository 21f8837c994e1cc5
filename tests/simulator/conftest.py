"""A small generator of road users, and a model of the tiny street by a method in a file."""

from __future__ import annotations

from pathlib import Path

import pytest

from hybridworldsim.generation.commands.model_paths import find_model_files
from hybridworldsim.generation.scenes.generator_files import GeneratorFiles
from hybridworldsim.generation.scenes.rollout import SceneGenerator
from mirror.methods.model_document import Costs, Reconstruction
from mirror.schema.files import write_json
from tests.simulator.generated_street import HEIGHT, WIDTH

METHOD = """
from mirror.methods.capabilities import Capabilities
from tests.simulator.generated_street import FlatStreet


class Method:
    capabilities = Capabilities(renders_depth=True)

    def reconstruct(self, dataset, task, out, progress):
        raise NotImplementedError

    def open(self, model, appearance):
        return FlatStreet()


METHOD = Method()
"""


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A model of the tiny street by a method in a file beside it."""
    (tmp_path / "method.py").write_text(METHOD)
    costs = Costs(model_bytes=1, driven_m=1.0, core_s=1.0, wall_s=1.0)
    document = Reconstruction(
        method="method.py:METHOD", scene="guangzhou-urban", split="novel", trained={"one": "0" * 64}, done=costs
    )
    (tmp_path / "model").mkdir()
    write_json(tmp_path / "model" / "reconstruction.json", document)
    return tmp_path / "model"


@pytest.fixture(scope="session")
def models(generator_models: Path) -> Path:
    """A generator and its autoencoder after one step each: their images are noise, which is enough here."""
    return generator_models / "out"


@pytest.fixture(scope="module")
def opened(models: Path) -> SceneGenerator:
    return GeneratorFiles(*find_model_files(models, None)).open((HEIGHT, WIDTH))
