"""The functions of renderers that a method's `Capabilities` state: depth, covers before a depth, exposure."""

from __future__ import annotations

from typing import Any, Protocol

from mirror.arrays import Float32
from mirror.protocols.views.view import RenderView


class DepthRendering(Protocol):
    """An image with depth; all are float tensors of torch, or float arrays of numpy."""

    @property
    def rgb(self) -> Any:
        """(H, W, 3) colours, 0 to 1."""
        ...

    @property
    def alpha(self) -> Any:
        """(H, W) share of each pixel that the model covers, 0 to 1."""
        ...

    @property
    def depth_m(self) -> Any:
        """(H, W) expected camera z."""
        ...


class DepthRenderer(Protocol):
    """A renderer that also returns depth."""

    def render(self, view: RenderView) -> DepthRendering:
        """Render a view with its depth."""
        ...


class CoverRenderer(Protocol):
    """A renderer that also returns the share of each pixel that the model nearer than a depth covers."""

    def render_covers(self, view: RenderView, limit_m: Float32) -> tuple[DepthRendering, Any]:
        """Render a view with its depth, and the share of each pixel that the model nearer than a depth covers.

        Args:
            view: the view.
            limit_m: (H, W) depth (camera z) of each pixel; 0 or less: nothing is before it.

        Returns:
            What `DepthRenderer.render` returns; and the shares (H, W), 0 to 1, of the same type.
        """
        ...


class ExposingRenderer(Protocol):
    """A renderer that separates the street from the exposure of the camera, so that road users get it too."""

    def render_unexposed(self, view: RenderView, limit_m: Float32 | None) -> tuple[DepthRendering, Any]:
        """Render a view at the mean exposure of its appearance.

        Args:
            view: the view.
            limit_m: see `CoverRenderer.render_covers`; None: nothing is computed for it.

        Returns:
            What `CoverRenderer.render_covers` returns; None in place of the shares where `limit_m` is None.
        """
        ...

    def expose(self, view: RenderView, colours: Any, noise_seed: int | None = None) -> Any:
        """Return the image (H, W, 3), 0 to 1, that the camera of a view takes of unexposed colours.

        Args:
            view: the view.
            colours: (H, W, 3) float tensor of torch: the unexposed street, into which road users may have been drawn.
            noise_seed: seed of the camera's noise; None: without noise.
        """
        ...
