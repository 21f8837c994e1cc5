"""Renderers by name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hybridworldsim.simulator.policies.protocol import CameraSpec
from hybridworldsim.simulator.renderers.protocol import Renderer
from hybridworldsim.simulator.simulation import Simulation
from hybridworldsim.simulator.street.street import Street, StreetRecording
from hybridworldsim.simulator.world import Snapshot
from mirror.devices import AUTO, CPU, OPTION, Device
from mirror.errors import UsageError
from mirror.methods.model import ModelFolder
from mirror.schema.scenario import Scenario

if TYPE_CHECKING:
    from hybridworldsim.generation.scenes.rollout import SceneGenerator
    from hybridworldsim.simulator.renderers.generated import DriveGenerator
    from hybridworldsim.simulator.renderers.reconstructed import ReconstructedRenderer

RENDERERS: Final = ("boxes", "exact", "reconstructed", "generated")
_OF_MODEL: Final = ("reconstructed", "generated")


class RendererFactory:
    """A factory of the renderer of each rollout, which keeps what rollouts share, such as an open model.

    Args:
        name: one of `RENDERERS`.
        model: folder of the trained model, for ``reconstructed`` and ``generated``.
        method: ``FILE.py:OBJECT`` of the model's method; None: it is installed.
        option: how the user names the method, for messages.
        device: where the model renders, see `mirror.methods.model.ModelFolder.choose_device`.
        generator: the generator, for ``generated``.

    Raises:
        UsageError: there is no such renderer, the model or the generator is missing, or one is named for a renderer
            that takes none.
    """

    def __init__(
        self,
        name: str,
        model: Path | None = None,
        method: str | None = None,
        *,
        option: str = "--method ",
        device: str = CPU,
        generator: DriveGenerator | None = None,
    ) -> None:
        if name not in RENDERERS:
            raise UsageError(f"no renderer {name!r}", expected=f"one of {', '.join(RENDERERS)}")
        if (name in _OF_MODEL) != (model is not None):
            raise UsageError(
                f"the renderer {name!r} {'needs a model' if model is None else 'has no model'}", place="model",
                expected="the folder of a trained model with 'reconstructed' and 'generated', and none with others",
            )  # fmt: skip
        if (name == "generated") != (generator is not None):
            raise UsageError(
                f"the renderer {name!r} {'needs a generator' if generator is None else 'has no generator'}",
                place="generator", expected="a generator with the renderer 'generated', and none with others",
                remedy="name one that `mirror generate train` wrote, or another renderer",
            )  # fmt: skip
        if method is not None and model is None:
            raise UsageError(method, place=option.strip(" ="), expected="none without a model: it renders one")
        self.name, self._model_path = name, model
        self._method, self._option, self._device = method, option, device
        self._model: object = None
        self._generator = generator
        self._opened: dict[tuple[tuple[int, int], ...], SceneGenerator] = {}

    def require_model_of(self, street: Street) -> None:
        """Require that the model, if there is one, is a model of the street; the model is not opened.

        Raises:
            UsageError: the model is of another scene.
            DatasetError: the folder holds no model.
        """
        if self._model_path is not None:
            from hybridworldsim.simulator.renderers.reconstructed import require_model_of

            require_model_of(self._model_path, street)

    def recordings_of(self, street: Street) -> dict[str, StreetRecording]:
        """Return the recordings of a street whose appearance can be rendered, by id.

        Raises:
            UsageError: the model is of another scene.
            DatasetError: the folder holds no model.
        """
        if self._model_path is None:
            return dict(street.recordings)
        from hybridworldsim.simulator.renderers.reconstructed import require_model_of

        _, trained = require_model_of(self._model_path, street)
        return {name: street.recordings[name] for name in trained}

    def make(self, simulation: Simulation, cameras: Mapping[str, CameraSpec]) -> Renderer:
        """Make the renderer of a rollout.

        Raises:
            UsageError: the renderer does not fit the street.
            DatasetError: the folder holds no complete model.
        """
        if self.name == "exact":
            from hybridworldsim.simulator.renderers.exact import ExactRenderer

            street, scenario = simulation.street, simulation.scenario
            return ExactRenderer(street, scenario, simulation.now, cameras, simulation.seed)
        if self._generator is not None:
            return self._make_generated(self._generator, simulation, cameras)
        return self.make_at(simulation.street, simulation.scenario, simulation.now, cameras, seed=simulation.seed)

    def make_at(
        self,
        street: Street,
        scenario: Scenario,
        start: Snapshot,
        cameras: Mapping[str, CameraSpec],
        appearance: str | None = None,
        *,
        seed: int = 0,
    ) -> Renderer:
        """Make a renderer of views from anywhere, without the body of the ego vehicle.

        Args:
            street: the street.
            scenario: its light and weather choose the appearance.
            start: the state at the start.
            cameras: the cameras, by name.
            appearance: see `ReconstructedRenderer`.
            seed: seed of the noise of a model's cameras.

        Raises:
            UsageError: the renderer does not fit the street.
            DatasetError: the folder holds no complete model.
        """
        if self.name == "exact":
            from hybridworldsim.simulator.renderers.exact import ExactRenderer

            return ExactRenderer(street, scenario, start, cameras, 0, shows_ego=False)
        if self.name == "boxes":
            from hybridworldsim.simulator.renderers.boxes import BoxesRenderer

            return BoxesRenderer(street, cameras)
        if self._generator is not None:
            raise UsageError(
                "views from anywhere of the renderer 'generated'", place="renderer",
                expected="a renderer that shows each instant by itself, such as 'reconstructed'",
            )  # fmt: skip
        return self._reconstructed(street, scenario, start, cameras, appearance, seed)

    def _make_generated(
        self, choice: DriveGenerator, simulation: Simulation, cameras: Mapping[str, CameraSpec]
    ) -> Renderer:
        from hybridworldsim.simulator.renderers.generated import GeneratedRenderer

        street, scenario = simulation.street, simulation.scenario
        base = self._reconstructed(street, scenario, simulation.now, cameras, None, simulation.seed)
        sizes = tuple((one.camera.height_px, one.camera.width_px) for one in cameras.values())
        if sizes not in self._opened:
            self._opened[sizes] = choice.open(cameras, self._device)
        return GeneratedRenderer(
            self._opened[sizes], choice, base, street, simulation.now, cameras, scenario.rate_hz, simulation.seed
        )

    def _reconstructed(
        self,
        street: Street,
        scenario: Scenario,
        start: Snapshot,
        cameras: Mapping[str, CameraSpec],
        appearance: str | None,
        seed: int,
    ) -> ReconstructedRenderer:
        from hybridworldsim.simulator.renderers.reconstructed import OpenModel, ReconstructedRenderer

        if not isinstance(self._model, OpenModel):
            self._model = OpenModel.read(
                self._model_path or Path(), street, self._method, option=self._option, device=self._device
            )
        return ReconstructedRenderer(self._model, street, scenario, start, cameras, appearance, seed)


def choose_renderer_device(requested: str | None, model: Path | None, method: str | None = None) -> Device | None:
    """Choose the device of a rollout's model; None without a model, because other renderers compute on the CPU.

    Args:
        requested: the value of ``--device``; None: it was not given.
        model: folder of the model, or None.
        method: ``FILE.py:OBJECT`` of the model's method; None: it is installed.

    Raises:
        UsageError: a device is requested without a model, or cannot be used.
        DatasetError: the folder holds no model that is trained to the end.
    """
    if model is None:
        if requested is not None:
            raise UsageError(
                requested, place=OPTION, expected="none without MODEL: a model is rendered",
                remedy=f"name the folder of a model, or leave {OPTION} out",
            )  # fmt: skip
        return None
    return ModelFolder.read(model, method).choose_device(requested or AUTO)
