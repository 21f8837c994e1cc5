"""The metrics that the leaderboard shows: title, unit, direction and possible values of each."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Literal


@dataclass(frozen=True)
class Measure:
    """One metric.

    Attributes:
        title: title of its column.
        about: description in one line.
        better: whether higher or lower values are better.
        digits: number of decimal places that are shown.
        low: smallest possible value.
        high: largest possible value.
        unit: unit of the shown values.
        scale: factor by which values are multiplied before they are shown.
        forgeable: whether renders that show no edit, or a copy of the recording, can reach the best value.
    """

    title: str
    about: str
    better: Literal["higher", "lower"]
    digits: int
    low: float = 0.0
    high: float = math.inf
    unit: str = ""
    scale: float = 1.0
    forgeable: bool = False

    def format(self, value: float) -> str:
        """Format a value for a table."""
        return f"{value * self.scale:.{self.digits}f}"

    @property
    def head(self) -> str:
        """The title with its unit."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    @property
    def arrow(self) -> str:
        """An arrow up or down: the direction of better values."""
        return "↑" if self.better == "higher" else "↓"


_PARTS: Final = {"least": "least part", "new": "new hull", "old": "old hull", "outside": "outside"}
_ABOUT: Final = {
    "least": "the least of new hulls, old hulls and outside, against the exact edit",
    "new": "in the hulls of the moved vehicles, against the exact edit",
    "old": "in the hulls where the vehicles were, against the exact edit",
    "outside": "outside the hulls of the vehicles, against the exact edit",
}

_OF_IMAGES: Final = {
    "psnr": Measure("PSNR", "peak signal-to-noise ratio of the scored pixels", "higher", 2, unit="dB"),
    "ms_structure": Measure(
        "Structure", "share of the truth's local structure that the render explains", "higher", 3, low=-1.0, high=1.0
    ),
    "psnr_invariant": Measure("PSNR inv.", "PSNR after the best linear recolouring", "higher", 2, unit="dB"),
    "psnr_affine": Measure("PSNR aff.", "PSNR after a gain and an offset of each channel", "higher", 2, unit="dB"),
    "psnr_cc": Measure("PSNR*", "PSNR after MTGS's quadratic colour correction", "higher", 2, unit="dB"),
    "ssim": Measure("SSIM", "structural similarity", "higher", 3, low=-1.0, high=1.0),
}

MEASURES: Final = {
    **_OF_IMAGES,
    **{
        f"{name}_{part}": replace(measure, title=f"{measure.title}, {title}", about=f"{measure.about}; {_ABOUT[part]}")
        for name, measure in _OF_IMAGES.items()
        for part, title in _PARTS.items()
    },
    "lpips": Measure("LPIPS", "learned perceptual distance, network not stated", "lower", 3),
    "lpips_alex": Measure("LPIPS alex", "learned perceptual distance, AlexNet", "lower", 3),
    "lpips_vgg": Measure("LPIPS vgg", "learned perceptual distance, VGG", "lower", 3),
    "lpips_squeeze": Measure("LPIPS squeeze", "learned perceptual distance, SqueezeNet", "lower", 3),
    "st_lpips_alex": Measure("ST-LPIPS alex", "shift-tolerant learned perceptual distance, AlexNet", "lower", 3),
    "st_lpips_vgg": Measure("ST-LPIPS vgg", "shift-tolerant learned perceptual distance, VGG", "lower", 3),
    "fid": Measure("FID", "Fréchet distance of Inception features", "lower", 2, forgeable=True),
    "kid": Measure(
        "KID",
        "kernel distance of Inception features, unbiased",
        "lower",
        2,
        low=-1.0,
        unit="10⁻³",
        scale=1e3,
        forgeable=True,
    ),
    "fvd": Measure("FVD", "Fréchet distance of I3D features of clips", "lower", 2, forgeable=True),
    "edit_iou": Measure(
        "IoU", "edited region with its target box, variant not stated", "higher", 2, high=1.0, forgeable=True
    ),
    "edit_iou_hull": Measure(
        "IoU hull", "edited mask with the target box's convex hull", "higher", 3, high=1.0, forgeable=True
    ),
    "edit_iou_box": Measure("IoU box", "tight rectangles of both", "higher", 3, high=1.0, forgeable=True),
    "edit_iou_ceiling": Measure(
        "IoU of ceiling", "share of the best that an exact mask reaches", "higher", 3, high=1.0, forgeable=True
    ),
    "mean_ap": Measure("mAP", "average precision over classes and distances (nuScenes)", "higher", 3, high=1.0),
    "nds": Measure("NDS", "nuScenes detection score", "higher", 3, high=1.0),
    "nds_no_attr": Measure("NDS without attributes", "mAP and four errors, weights 5 : 1", "higher", 3, high=1.0),
    "mate_m": Measure("mATE", "translation error of true positives", "lower", 3, unit="m"),
    "mase": Measure("mASE", "scale error of true positives", "lower", 3, high=1.0),
    "maoe_rad": Measure("mAOE", "orientation error of true positives", "lower", 3, unit="rad"),
    "mave_mps": Measure("mAVE", "velocity error of true positives", "lower", 3, unit="m/s"),
    "maae": Measure("mAAE", "attribute error of true positives", "lower", 3, high=1.0),
    "frames_per_second": Measure("Rendering", "images per second", "higher", 1, unit="FPS"),
    "mvs_frames_per_second": Measure("MVS initialisation", "images per second, 1280 × 960", "higher", 1, unit="FPS"),
    "model_bytes_per_100m": Measure("Model", "size of the static model", "lower", 1, unit="MB / 100 m", scale=1e-6),
    "training_s": Measure("Training", "time", "lower", 2, unit="h", scale=1 / 3600),
    "peak_memory_bytes": Measure("Peak memory", "while rendering", "lower", 2, unit="GB", scale=1e-9),
    "epdms": Measure("EPDMS", "driving score of NAVSIM v2 over the whole drive", "higher", 3, high=1.0),
    "pdms": Measure("PDMS", "driving score of NAVSIM v1 over the whole drive", "higher", 3, high=1.0),
    "at_fault_collisions": Measure("At fault", "collisions a drive that the ego caused (nuPlan)", "lower", 2),
    "collisions": Measure("Collisions", "collisions a drive", "lower", 2),
    "impact_speed": Measure("Impact", "largest relative speed at a contact; 0: none", "lower", 2, unit="m/s"),
    "least_ttc": Measure("TTC", "least time to collision, continuous in time", "higher", 2, unit="s"),
    "ttc_nuplan_within_bound": Measure("TTC nuPlan", "drives above 0.95 s as nuPlan has it", "higher", 2, high=1.0),
    "ttc_navsim_within_bound": Measure("TTC NAVSIM", "drives that pass NAVSIM's definition", "higher", 2, high=1.0),
    "drivable_area": Measure("Drivable area", "drives with all corners inside", "higher", 2, high=1.0),
    "drivable_margin": Measure(
        "Margin", "least distance of a corner from the edge of the road", "higher", 2, low=-math.inf, unit="m"
    ),
    "off_road": Measure("Off road", "distance with a corner outside the drivable area", "lower", 1, unit="m"),
    "wrong_lane": Measure("Wrong lane", "distance in lanes of the other direction", "lower", 1, unit="m"),
    "red_lights": Measure("Red lights", "stop lines passed at red, a drive", "lower", 2),
    "comfort": Measure("Comfort", "drives within nuPlan's bounds", "higher", 2, high=1.0),
    "progress_share": Measure("Progress", "share of the distance at the scenario's speed", "higher", 2, high=1.0),
}
