"""What a method's renderers have if its `Capabilities` state it: depth, and what covers each pixel before a depth."""

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
