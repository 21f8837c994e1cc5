"""A trained model: its folder suffices to open it, by the method that its document names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from mirror.arrays import Float32, UInt8
from mirror.devices import CPU, Device, choose_device
from mirror.errors import UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.capabilities import Capabilities, find_capabilities, require_renderer_capabilities
from mirror.methods.depth_renderers import CoverRenderer, DepthRenderer, DepthRendering, ExposingRenderer
from mirror.methods.hosting import checked_renderer
from mirror.methods.interactive import (
    InteractiveDeviceMethod,
    InteractiveMethod,
    InteractiveRenderer,
    PlainRenderer,
    TrainedAppearance,
)
from mirror.methods.method_devices import DeviceMethod
from mirror.methods.model_document import Reconstruction, read_reconstruction, require_finished
from mirror.methods.plugin import InstalledMethod
from mirror.methods.ply_export import PlyExport, PlyExporter, PlyExportOptions
from mirror.methods.registry import METHODS, method_of_model
from mirror.protocols.views.view import RenderView


class ModelRenderer:
    """A trained model as a function of views, whose method's output is checked.

    Args:
        name: name of the method, for messages.
        renderer: what the method's `open` returned.
        capabilities: capabilities of the method and of this renderer.

    Raises:
        UsageError: `renderer` is no function.
    """

    def __init__(self, name: str, renderer: Callable[[RenderView], UInt8], capabilities: Capabilities) -> None:
        self.capabilities = capabilities
        self._name, self._renderer = name, renderer
        self._render = checked_renderer(name, renderer)

    def __call__(self, view: RenderView) -> UInt8:
        """Render the pixels (H, W, 3) of a view.

        Raises:
            UsageError: the method returned something else.
        """
        return self._render(view)

    def render(self, view: RenderView) -> DepthRendering:
        """Render a view with its depth.

        Raises:
            UsageError: the method lacks the capability `renders_depth`.
        """
        self._require("renders_depth")
        return cast(DepthRenderer, self._renderer).render(view)

    def render_covers(self, view: RenderView, limit_m: Float32) -> tuple[DepthRendering, Any]:
        """Render a view with its depth and the share of each pixel that the model before a depth covers.

        Raises:
            UsageError: the method lacks the capability `renders_covers`.
        """
        self._require("renders_covers")
        return cast(CoverRenderer, self._renderer).render_covers(view, limit_m)

    def render_unexposed(self, view: RenderView, limit_m: Float32 | None) -> tuple[DepthRendering, Any]:
        """Render a view at the mean exposure of its appearance; see `ExposingRenderer.render_unexposed`.

        Raises:
            UsageError: the method lacks the capability `separates_exposure`.
        """
        self._require("separates_exposure")
        return cast(ExposingRenderer, self._renderer).render_unexposed(view, limit_m)

    def expose(self, view: RenderView, colours: Any, noise_seed: int | None = None) -> Any:
        """Return the image that a view's camera takes of unexposed colours; see `ExposingRenderer.expose`.

        Raises:
            UsageError: the method lacks the capability `separates_exposure`.
        """
        self._require("separates_exposure")
        return cast(ExposingRenderer, self._renderer).expose(view, colours, noise_seed)

    def _require(self, capability: str) -> None:
        if capability not in self.capabilities.names:
            raise UsageError(f"method {self._name}", expected=f"a method with the capability {capability}")


@dataclass(frozen=True)
class ModelFolder:
    """A trained model and its method; its files are read when it is opened.

    Attributes:
        folder: folder of the model.
        document: its document.
        method: the method that renders it.
    """

    folder: Path
    document: Reconstruction
    method: InstalledMethod

    @classmethod
    def read(cls, folder: Path, given: str | None = None, *, option: str = "--method ") -> ModelFolder:
        """Read the document of a model, and load its method.

        Args:
            folder: folder of the model.
            given: ``FILE.py:OBJECT`` of the model's method; None: it is installed.
            option: how the user names the method, for messages.

        Raises:
            DatasetError: the folder holds no model that is trained to the end.
            UsageError: the method cannot be loaded; see `method_of_model`.
        """
        document = read_reconstruction(folder)
        method = method_of_model(document.method, given, option=option)
        require_finished(document, folder)
        return cls(folder, document, method)

    @property
    def name(self) -> str:
        """Return the name of the method in the model's document."""
        return self.document.method

    def choose_device(self, requested: str) -> Device:
        """Choose the device that renders the model; see `mirror.devices.choose_device`."""
        stated = find_capabilities(self.method)
        return choose_device(
            requested, f"method {self.name}", takes_device=stated.takes_device, splats=stated.rasterizes
        )

    def open(
        self,
        appearance: AppearancePolicy = AppearancePolicy(),  # noqa: B008 - immutable
        *,
        device: str = CPU,
    ) -> ModelRenderer:
        """Open a renderer.

        Args:
            appearance: appearance policy for views that were not trained on.
            device: where it computes, as `choose_device` names it.

        Raises:
            DatasetError: the folder holds no complete model of the method.
            UsageError: the method does not support the policy, or does not return what its capabilities state.
        """
        if device == CPU:
            renderer = self.method.open(self.folder, appearance)
        else:
            renderer = cast(DeviceMethod, self.method).open(self.folder, appearance, device=device)
        require_renderer_capabilities(METHODS, self.method, renderer, self.name)
        return ModelRenderer(self.name, renderer, find_capabilities(self.method, renderer))

    def open_interactive(self, appearances: Sequence[TrainedAppearance], *, device: str = CPU) -> InteractiveRenderer:
        """Open the model for interactive rendering.

        Args:
            appearances: the trained traversals, for a method without the capability `opens_interactively`.
            device: where it computes, as `choose_device` names it.

        Raises:
            DatasetError: the folder holds no complete model of the method.
            UsageError: the method does not return what its capabilities state.
        """
        if find_capabilities(self.method).opens_interactively:
            if device == CPU:
                return cast(InteractiveMethod, self.method).open_interactive(self.folder)
            return cast(InteractiveDeviceMethod, self.method).open_interactive(self.folder, device=device)
        return PlainRenderer(tuple(appearances), self.open(device=device))

    def export_ply(
        self, views: Sequence[RenderView], out: Path, options: PlyExportOptions, appearance: AppearancePolicy
    ) -> PlyExport:
        """Write the model as a PLY file; see `PlyExporter.export_ply`.

        Raises:
            DatasetError: the folder holds no complete model of the method.
            UsageError: the method lacks the capability `exports_ply`.
        """
        if not find_capabilities(self.method).exports_ply:
            raise UsageError(
                f"method {self.name} cannot export a PLY", file=self.folder,
                expected="a model by a method with a function `export_ply`",
            )  # fmt: skip
        return cast(PlyExporter, self.method).export_ply(self.folder, views, out, options, appearance)


def read_models(folders: Sequence[Path], given: str | None = None) -> dict[str, ModelFolder]:
    """Read models of several scenes by one method.

    Args:
        folders: folders of the models, at least one.
        given: ``FILE.py:OBJECT`` of their method; None: it is installed.

    Returns:
        The models by scene.

    Raises:
        DatasetError: a folder holds no model that is trained to the end.
        UsageError: two models are of one scene or by different methods, or the method cannot be loaded.
    """
    documents = [read_reconstruction(folder) for folder in folders]
    methods = sorted({document.method for document in documents})
    scenes = {document.scene for document in documents}
    if len(methods) != 1 or len(scenes) != len(documents):
        raise UsageError(
            f"{len(documents)} models by {', '.join(methods)} of {len(scenes)} scenes",
            expected="models by one method, one of each scene",
        )
    method = method_of_model(methods[0], given)
    for folder, document in zip(folders, documents):
        require_finished(document, folder)
    return {document.scene: ModelFolder(folder, document, method) for folder, document in zip(folders, documents)}


def open_model(
    folder: Path, appearance: AppearancePolicy = AppearancePolicy(), method: str | None = None  # noqa: B008 - immutable
) -> ModelRenderer:  # fmt: skip
    """Open a trained model as a function from a view to its pixels; no dataset is read.

    Args:
        folder: the folder that ``mirror reconstruct`` wrote.
        appearance: appearance policy for views that were not trained on.
        method: ``FILE.py:OBJECT`` of the model's method; None: it is installed.

    Raises:
        DatasetError: the folder holds no complete model.
        UsageError: the method cannot be loaded, or does not support the policy.
    """
    return ModelFolder.read(folder, method, option="method=").open(appearance)
