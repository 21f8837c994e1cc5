"""The report of `mirror align`: for each pass what it was matched with, how far it moved, and its uncertainty."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class PassReport:
    """One pass.

    Attributes:
        traversal_id: the pass.
        status: ``aligned``, ``existing`` (the layer was there), ``kept`` (its poses stay as they are) or ``failed``.
        problem: why it is not aligned; None: it is.
        images: number of its used images.
        registered: number of them that are in the map.
        matched_with: number of points that it shares with each other pass, by traversal.
        moved_m: mean distance by which its poses moved.
        turned_deg: mean angle by which they turned.
        sigma_m: 1-sigma of its positions against the other passes, all axes; None: unknown.
        sigma_deg: 1-sigma of its rotations against the other passes; None: unknown.
    """

    traversal_id: str
    status: str
    problem: str | None = None
    images: int = 0
    registered: int = 0
    matched_with: dict[str, int] = field(default_factory=dict)
    moved_m: float = 0.0
    turned_deg: float = 0.0
    sigma_m: float | None = None
    sigma_deg: float | None = None


@dataclass
class AlignmentReport:
    """The result of an alignment.

    Attributes:
        dataset: the dataset.
        layer: name of the layer of poses, ``aligned@VERSION``.
        passes: its passes.
        residual_px: mean distance of features from the projections of their points, by scene.
    """

    dataset: Path
    layer: str
    passes: list[PassReport] = field(default_factory=list)
    residual_px: dict[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return the report, for JSON."""
        return {"dataset": str(self.dataset), "layer": self.layer, "residual_px": self.residual_px,
                "passes": [asdict(one) for one in self.passes]}  # fmt: skip

    def lines(self) -> list[str]:
        """Return the report in words."""
        lines = [f"layer poses/{self.layer}"]
        lines += [f"  {scene}: {value:.2f} px" for scene, value in self.residual_px.items()]
        for one in self.passes:
            if one.status == "aligned":
                others = ", ".join(f"{count} with {name}" for name, count in one.matched_with.items())
                sigma = f" +- {one.sigma_m:.3f} m, {one.sigma_deg:.3f} degrees" if one.sigma_m is not None else ""
                lines.append(
                    f"  {one.traversal_id}: {one.registered} of {one.images} images, moved {one.moved_m:.2f} m and"
                    f" {one.turned_deg:.2f} degrees{sigma}; points shared: {others}"
                )
            else:
                lines.append(f"  {one.traversal_id}: {one.status}" + (f": {one.problem}" if one.problem else ""))
        return lines
