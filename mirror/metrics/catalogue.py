"""The catalogue of metrics: name, unit, direction, bounds, needs, function and one sentence of each.

Protocols, scorers, reports, comparisons, boards and docs/metrics.md read it. A metric of single images or of rollouts
without options is added by its file and one entry here, which names the function that scorers call.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

from mirror.errors import UsageError

Kind = Literal["image", "set", "boxes", "method", "rollout"]
"""What has one value of a metric: an image, a set of images or clips, all boxes of a set, a method, a rollout."""

_OF_CLASS: Final = "ap_"


@dataclass(frozen=True)
class Measure:
    """One metric: its title, sentence, unit, direction, bounds, weights and function.

    Attributes:
        title: title of its column.
        about: its sentence in pages, without the full stop.
        better: whether higher or lower values are better.
        digits: number of decimal places that boards show.
        low: smallest possible value.
        high: largest possible value.
        unit: unit of the values in results.
        shown_unit: unit of the values on boards; None: `unit`.
        scale: factor by which values are multiplied before boards show them.
        forgeable: whether renders that show no edit, or a copy of the recording, can reach the best value.
        kind: what has one value of it.
        is_plain: whether protocols name it by its name alone. Other metrics have options, which a class of
            mirror/protocols/metrics.py states, or are beside another metric.
        function: ``module:function`` that computes one value of a plain metric; None: a scorer computes it. For images
            it takes (render, truth, *, mask) and returns a `Score`; for rollouts it takes (log, road map or None, route
            or None) and returns a `SafetyFigure`.
        needs: names of the weights that it needs.
        is_listed: whether boards show it.
        may_rank: whether boards may order by it where their protocol does not say by which.
        name: name in protocols, results and boards; the key of `MEASURES`.
    """

    title: str
    about: str
    better: Literal["higher", "lower"]
    digits: int
    low: float = 0.0
    high: float = math.inf
    unit: str = ""
    shown_unit: str | None = None
    scale: float = 1.0
    forgeable: bool = False
    kind: Kind = "image"
    is_plain: bool = False
    function: str | None = None
    needs: tuple[str, ...] = ()
    is_listed: bool = True
    may_rank: bool = True
    name: str = ""

    def _repr_html_(self) -> str:
        """Return the metric as HTML for notebooks: its name, sentence, unit, direction and bounds."""
        from mirror.pages.notebook import show_summary

        facts = [
            ("name", self.name),
            ("about", self.about),
            ("unit", self.unit or "none"),
            ("better", self.better),
            ("bounds", f"{self.low:g} to {self.high:g}"),
            ("weights", ", ".join(self.needs) or "none"),
        ]
        return show_summary(self.title, (), facts)

    def format(self, value: float) -> str:
        """Format a value for a board."""
        return f"{value * self.scale:.{self.digits}f}"

    def format_exactly(self, value: float) -> str:
        """Format a value of a result, in `unit`, with more digits than a board."""
        return f"{value:.{2 if self.unit == 'dB' else 4}f}"

    @property
    def board_unit(self) -> str:
        """The unit of the values on boards."""
        return self.unit if self.shown_unit is None else self.shown_unit

    @property
    def head(self) -> str:
        """The title with its unit."""
        return f"{self.title} ({self.board_unit})" if self.board_unit else self.title

    @property
    def arrow(self) -> str:
        """An arrow up or down: the direction of better values."""
        return "↑" if self.better == "higher" else "↓"

    def load(self) -> Any:
        """Import the function.

        Raises:
            TypeError: a scorer computes the metric.
        """
        if self.function is None:
            raise TypeError(f"{self.name} has no function: a scorer computes it")
        module, _, name = self.function.partition(":")
        return getattr(importlib.import_module(module), name)


_PART_TITLES: Final = {"least": "least part", "new": "new hull", "old": "old hull", "outside": "outside"}
PARTS: Final = {
    "least": "the least of new hulls, old hulls and outside, against the exact edit",
    "new": "in the hulls of the moved vehicles, against the exact edit",
    "old": "in the hulls where the vehicles were, against the exact edit",
    "outside": "outside the hulls of the vehicles, against the exact edit",
}
"""The parts of an image whose vehicles are edited, each with its sentence."""

_OF_IMAGES: Final = {
    "psnr": Measure(
        "PSNR",
        "peak signal-to-noise ratio of the scored pixels",
        "higher",
        2,
        unit="dB",
        is_plain=True,
        function="mirror.metrics.images.psnr:psnr",
    ),
    "matched_structure": Measure(
        "Structure",
        "share of the truth's local structure that the render matches",
        "higher",
        3,
        low=0.0,
        high=1.0,
        is_plain=True,
        function="mirror.metrics.images.matched_structure:matched_structure",
    ),
    "ms_structure": Measure(
        "Structure, all",
        "share of the truth's local structure that the render explains",
        "higher",
        3,
        low=-1.0,
        high=1.0,
        is_plain=True,
        function="mirror.metrics.images.structure:ms_structure",
    ),
    "psnr_invariant": Measure(
        "PSNR inv.",
        "PSNR after the best linear recolouring",
        "higher",
        2,
        unit="dB",
        is_plain=True,
        function="mirror.metrics.images.invariant:psnr_invariant",
    ),
    "psnr_affine": Measure(
        "PSNR aff.",
        "PSNR after a gain and an offset of each channel",
        "higher",
        2,
        unit="dB",
        is_plain=True,
        function="mirror.metrics.images.affine:psnr_affine_db",
        may_rank=False,
    ),
    "psnr_cc": Measure(
        "PSNR*", "PSNR after MTGS's quadratic colour correction", "higher", 2, unit="dB", may_rank=False
    ),
    "ssim": Measure("SSIM", "structural similarity", "higher", 3, low=-1.0, high=1.0),
}

_POOLED: Final = {
    "psnr_pooled": Measure(
        "PSNR pooled", "PSNR of the mean squared error over all images", "higher", 2, unit="dB", is_listed=False
    ),
}

_OF_PARTS: Final = {
    f"{name}_{part}": replace(
        measure,
        title=f"{measure.title}, {title}",
        about=f"{measure.about}; {PARTS[part]}",
        is_plain=False,
        function=None,
    )
    for name, measure in _OF_IMAGES.items()
    for part, title in _PART_TITLES.items()
}

_PERCEPTUAL: Final = {
    "lpips": Measure("LPIPS", "learned perceptual distance, network not stated", "lower", 3),
    "lpips_alex": Measure(
        "LPIPS alex", "learned perceptual distance, AlexNet", "lower", 3, needs=("alexnet", "lpips-heads-alex")
    ),
    "lpips_vgg": Measure(
        "LPIPS vgg", "learned perceptual distance, VGG", "lower", 3, needs=("vgg16", "lpips-heads-vgg")
    ),
    "lpips_squeeze": Measure(
        "LPIPS squeeze",
        "learned perceptual distance, SqueezeNet",
        "lower",
        3,
        needs=("squeezenet1_1", "lpips-heads-squeeze"),
    ),
    "st_lpips_alex": Measure(
        "ST-LPIPS alex", "shift-tolerant learned perceptual distance, AlexNet", "lower", 3, needs=("st-lpips-alex",)
    ),
    "st_lpips_vgg": Measure(
        "ST-LPIPS vgg", "shift-tolerant learned perceptual distance, VGG", "lower", 3, needs=("st-lpips-vgg",)
    ),
}

_OF_SETS: Final = {
    "fid": Measure(
        "FID", "Fréchet distance of Inception features", "lower", 2, forgeable=True, needs=("inception-fid",)
    ),
    "kid": Measure(
        "KID",
        "kernel distance of Inception features, unbiased",
        "lower",
        2,
        low=-1.0,
        shown_unit="10⁻³",
        scale=1e3,
        forgeable=True,
        needs=("inception-fid",),
    ),
    "fvd": Measure(
        "FVD", "Fréchet distance of I3D features of clips", "lower", 2, forgeable=True, needs=("i3d-torchscript",)
    ),
}

_OF_REGIONS: Final = {
    "edit_iou": Measure(
        "IoU", "IoU of the edited region with its target box, variant not stated", "higher", 2, high=1.0, forgeable=True
    ),
    "edit_iou_hull": Measure(
        "IoU hull", "IoU of the edited mask with the target box's convex hull", "higher", 3, high=1.0, forgeable=True
    ),
    "edit_iou_box": Measure(
        "IoU box",
        "IoU of the tight rectangles of the edited mask and its target box",
        "higher",
        3,
        high=1.0,
        forgeable=True,
    ),
    "edit_iou_ceiling": Measure(
        "IoU of ceiling",
        "IoU with the target box's rectangle, as a share of that of an exact mask",
        "higher",
        3,
        high=1.0,
        forgeable=True,
    ),
}

_OF_BOXES: Final = {
    "mean_ap": Measure("mAP", "average precision over classes and distances (nuScenes)", "higher", 3, high=1.0),
    "nds": Measure("NDS", "nuScenes detection score", "higher", 3, high=1.0),
    "nds_no_attr": Measure(
        "NDS without attributes", "mean of mAP and four errors, weights 5 : 1", "higher", 3, high=1.0
    ),
    "mate_m": Measure("mATE", "translation error of true positives", "lower", 3, unit="m"),
    "mase": Measure("mASE", "scale error of true positives", "lower", 3, high=1.0),
    "maoe_rad": Measure("mAOE", "orientation error of true positives", "lower", 3, unit="rad"),
    "mave_mps": Measure("mAVE", "velocity error of true positives", "lower", 3, unit="m/s"),
    "maae": Measure("mAAE", "attribute error of true positives", "lower", 3, high=1.0),
    "ap": Measure(
        "AP",
        "average precision of one class over distances (nuScenes): ap_car of cars",
        "higher",
        3,
        high=1.0,
        is_listed=False,
    ),
}

_OF_METHODS: Final = {
    "frames_per_second": Measure(
        "Rendering", "images per second", "higher", 1, unit="Hz", shown_unit="FPS", is_plain=True
    ),
    "mvs_frames_per_second": Measure(
        "MVS initialisation",
        "images per second of the multi-view stereo, 1280 × 960",
        "higher",
        1,
        unit="Hz",
        shown_unit="FPS",
    ),
    "model_bytes_per_100m": Measure(
        "Model", "size of the static model", "lower", 1, unit="B", shown_unit="MB / 100 m", scale=1e-6, is_plain=True
    ),
    "training_s": Measure(
        "Training", "time of training", "lower", 2, unit="s", shown_unit="h", scale=1 / 3600, is_plain=True
    ),
    "peak_memory_bytes": Measure(
        "Peak memory", "most memory while rendering", "lower", 2, unit="B", shown_unit="GB", scale=1e-9, is_plain=True
    ),
}

_OF_ROLLOUTS: Final = {
    "epdms": Measure("EPDMS", "driving score of NAVSIM v2 over the whole drive", "higher", 3, high=1.0, is_plain=True),
    "pdms": Measure("PDMS", "driving score of NAVSIM v1 over the whole drive", "higher", 3, high=1.0, is_plain=True),
    "at_fault_collisions": Measure(
        "At fault", "collisions a drive that the ego caused (nuPlan)", "lower", 2, is_plain=True
    ),
    "collisions": Measure("Collisions", "collisions a drive", "lower", 2, is_plain=True),
    "impact_speed": Measure(
        "Impact", "largest relative speed at a contact, 0 without one", "lower", 2, unit="m/s", is_plain=True
    ),
    "least_ttc": Measure("TTC", "least time to collision, continuous in time", "higher", 2, unit="s"),
    "ttc_nuplan_within_bound": Measure(
        "TTC nuPlan", "share of drives above 0.95 s to collision as nuPlan has it", "higher", 2, high=1.0, is_plain=True
    ),
    "ttc_navsim_within_bound": Measure(
        "TTC NAVSIM",
        "share of drives that pass NAVSIM's test of time to collision",
        "higher",
        2,
        high=1.0,
        is_plain=True,
    ),
    "drivable_area": Measure(
        "Drivable area", "share of drives with all corners inside the drivable area", "higher", 2, high=1.0
    ),
    "drivable_margin": Measure(
        "Margin",
        "least distance of a corner from the edge of the road",
        "higher",
        2,
        low=-math.inf,
        unit="m",
        is_plain=True,
    ),
    "off_road": Measure(
        "Off road", "distance with a corner outside the drivable area", "lower", 1, unit="m", is_plain=True
    ),
    "wrong_lane": Measure(
        "Wrong lane", "distance in lanes of the other direction", "lower", 1, unit="m", is_plain=True
    ),
    "red_lights": Measure("Red lights", "stop lines passed at red, a drive", "lower", 2, is_plain=True),
    "comfort": Measure("Comfort", "share of drives within nuPlan's bounds", "higher", 2, high=1.0, is_plain=True),
    "ttc_nuplan": Measure(
        "Least TTC nuPlan", "least time to collision as nuPlan has it", "higher", 2, unit="s", is_listed=False
    ),
    "progress": Measure("Way", "distance along the route", "higher", 1, low=-math.inf, unit="m", is_listed=False),
    "progress_share": Measure(
        "Progress", "driven share of the distance at the scenario's speed", "higher", 2, high=1.0, is_plain=True
    ),
}

_GROUPS: Final[tuple[tuple[Kind, dict[str, Measure]], ...]] = (
    ("image", _OF_IMAGES),
    ("image", _OF_PARTS),
    ("set", _POOLED),
    ("image", _PERCEPTUAL),
    ("set", _OF_SETS),
    ("image", _OF_REGIONS),
    ("boxes", _OF_BOXES),
    ("method", _OF_METHODS),
    ("rollout", _OF_ROLLOUTS),
)

MEASURES: Final[dict[str, Measure]] = {
    name: replace(measure, kind=kind, name=name) for kind, group in _GROUPS for name, measure in group.items()
}
"""All metrics by name, in the order in which boards show them."""


def find_measure(metric: str) -> Measure:
    """Find the catalogue's entry for a figure's metric; ``ap_CLASS`` is the ``ap`` of that class.

    Raises:
        UsageError: the catalogue has no such metric.
    """
    if metric.startswith(_OF_CLASS):
        return replace(MEASURES["ap"], name=metric, title=f"AP {metric.removeprefix(_OF_CLASS).replace('_', ' ')}")
    if metric not in MEASURES:
        raise UsageError(
            f"metric {metric!r} is unknown",
            expected="a metric of docs/metrics.md",
            remedy="evaluate the submission again with this version of the toolkit",
        )
    return MEASURES[metric]


def plain_names(kind: Kind) -> tuple[str, ...]:
    """List the metrics of a kind that protocols name without options."""
    return tuple(name for name, measure in MEASURES.items() if measure.kind == kind and measure.is_plain)
