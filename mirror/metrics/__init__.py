"""Metrics: functions of arrays or tensors, and accumulators with ``update``, ``merge`` and ``compute`` beside them.

`mirror.metrics.images` compares renders with photographs, `mirror.metrics.features` distributions of images,
`mirror.metrics.boxes` regions, `mirror.metrics.detection` annotations. The names below are imported on first use. Every
variant of a metric has a name, and ``docs/metrics`` says what each reproduces.
"""

from __future__ import annotations

from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.metrics.boxes.iou_2d import RegionIou as RegionIou
    from mirror.metrics.boxes.iou_2d import box_iou_2d as box_iou_2d
    from mirror.metrics.boxes.iou_2d import hull_iou as hull_iou
    from mirror.metrics.boxes.iou_2d import mask_iou as mask_iou
    from mirror.metrics.boxes.iou_3d import box_iou_3d as box_iou_3d
    from mirror.metrics.boxes.iou_3d import box_iou_3d_matrix as box_iou_3d_matrix
    from mirror.metrics.boxes.projected import visible_share as visible_share
    from mirror.metrics.boxes.raster import polygon_mask as polygon_mask
    from mirror.metrics.detection.boxes import DetectionBoxes as DetectionBoxes
    from mirror.metrics.detection.config import DETECTION_CVPR_2019 as DETECTION_CVPR_2019
    from mirror.metrics.detection.config import DetectionConfig as DetectionConfig
    from mirror.metrics.detection.nuscenes import NuScenesAccumulator as NuScenesAccumulator
    from mirror.metrics.detection.nuscenes import NuScenesDetection as NuScenesDetection
    from mirror.metrics.detection.nuscenes import nuscenes_detection as nuscenes_detection
    from mirror.metrics.features.cache import FeatureCache as FeatureCache
    from mirror.metrics.features.extractor import Extractor as Extractor
    from mirror.metrics.features.extractor import extract as extract
    from mirror.metrics.features.fid import Fid as Fid
    from mirror.metrics.features.fid import InceptionFeatures as InceptionFeatures
    from mirror.metrics.features.fid import fid as fid
    from mirror.metrics.features.fid import fid_of_features as fid_of_features
    from mirror.metrics.features.fid import load_inception as load_inception
    from mirror.metrics.features.frechet import FrechetDistance as FrechetDistance
    from mirror.metrics.features.frechet import frechet_distance as frechet_distance
    from mirror.metrics.features.fvd import Fvd as Fvd
    from mirror.metrics.features.fvd import VideoFeatures as VideoFeatures
    from mirror.metrics.features.fvd import fvd as fvd
    from mirror.metrics.features.fvd import load_i3d as load_i3d
    from mirror.metrics.features.kid import KernelDistance as KernelDistance
    from mirror.metrics.features.kid import kid as kid
    from mirror.metrics.features.lpips import load_lpips as load_lpips
    from mirror.metrics.features.lpips import lpips as lpips
    from mirror.metrics.features.perceptual import PerceptualDistance as PerceptualDistance
    from mirror.metrics.features.st_lpips import load_st_lpips as load_st_lpips
    from mirror.metrics.features.st_lpips import st_lpips as st_lpips
    from mirror.metrics.features.statistics import FeatureAccumulator as FeatureAccumulator
    from mirror.metrics.features.statistics import FeatureStatistics as FeatureStatistics
    from mirror.metrics.images.affine import AffinePsnr as AffinePsnr
    from mirror.metrics.images.affine import psnr_affine as psnr_affine
    from mirror.metrics.images.aggregate import Summary as Summary
    from mirror.metrics.images.aggregate import by_group as by_group
    from mirror.metrics.images.aggregate import summarise as summarise
    from mirror.metrics.images.bootstrap import Difference as Difference
    from mirror.metrics.images.bootstrap import Interval as Interval
    from mirror.metrics.images.bootstrap import frame_blocks as frame_blocks
    from mirror.metrics.images.bootstrap import mean_interval as mean_interval
    from mirror.metrics.images.bootstrap import paired_difference as paired_difference
    from mirror.metrics.images.colour_correction import CorrectedPsnr as CorrectedPsnr
    from mirror.metrics.images.colour_correction import correct_colours as correct_colours
    from mirror.metrics.images.colour_correction import psnr_cc as psnr_cc
    from mirror.metrics.images.invariant import psnr_invariant as psnr_invariant
    from mirror.metrics.images.matched_structure import matched_structure as matched_structure
    from mirror.metrics.images.psnr import Psnr as Psnr
    from mirror.metrics.images.psnr import PsnrSummary as PsnrSummary
    from mirror.metrics.images.psnr import psnr as psnr
    from mirror.metrics.images.ssim import Ssim as Ssim
    from mirror.metrics.images.ssim import ssim as ssim
    from mirror.metrics.images.ssim import ssim_map as ssim_map
    from mirror.metrics.images.ssim_map import SsimSettings as SsimSettings
    from mirror.metrics.images.structure import ms_structure as ms_structure
    from mirror.metrics.ranks import RankIntervals as RankIntervals
    from mirror.metrics.ranks import rank_intervals as rank_intervals
    from mirror.metrics.score import Score as Score

__all__ = [
    "DETECTION_CVPR_2019",
    "AffinePsnr",
    "CorrectedPsnr",
    "DetectionBoxes",
    "DetectionConfig",
    "Difference",
    "Extractor",
    "FeatureAccumulator",
    "FeatureCache",
    "FeatureStatistics",
    "Fid",
    "FrechetDistance",
    "Fvd",
    "InceptionFeatures",
    "Interval",
    "KernelDistance",
    "NuScenesAccumulator",
    "NuScenesDetection",
    "PerceptualDistance",
    "Psnr",
    "PsnrSummary",
    "RankIntervals",
    "RegionIou",
    "Score",
    "Ssim",
    "SsimSettings",
    "Summary",
    "VideoFeatures",
    "box_iou_2d",
    "box_iou_3d",
    "box_iou_3d_matrix",
    "by_group",
    "correct_colours",
    "extract",
    "fid",
    "fid_of_features",
    "frame_blocks",
    "frechet_distance",
    "fvd",
    "hull_iou",
    "kid",
    "load_i3d",
    "load_inception",
    "load_lpips",
    "load_st_lpips",
    "lpips",
    "mask_iou",
    "matched_structure",
    "mean_interval",
    "ms_structure",
    "nuscenes_detection",
    "paired_difference",
    "polygon_mask",
    "psnr",
    "psnr_affine",
    "psnr_cc",
    "psnr_invariant",
    "rank_intervals",
    "ssim",
    "ssim_map",
    "st_lpips",
    "summarise",
    "visible_share",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "AffinePsnr": "mirror.metrics.images.affine",
        "CorrectedPsnr": "mirror.metrics.images.colour_correction",
        "DETECTION_CVPR_2019": "mirror.metrics.detection.config",
        "DetectionBoxes": "mirror.metrics.detection.boxes",
        "DetectionConfig": "mirror.metrics.detection.config",
        "Difference": "mirror.metrics.images.bootstrap",
        "Extractor": "mirror.metrics.features.extractor",
        "FeatureAccumulator": "mirror.metrics.features.statistics",
        "FeatureCache": "mirror.metrics.features.cache",
        "FeatureStatistics": "mirror.metrics.features.statistics",
        "Fid": "mirror.metrics.features.fid",
        "FrechetDistance": "mirror.metrics.features.frechet",
        "Fvd": "mirror.metrics.features.fvd",
        "InceptionFeatures": "mirror.metrics.features.fid",
        "Interval": "mirror.metrics.images.bootstrap",
        "KernelDistance": "mirror.metrics.features.kid",
        "NuScenesAccumulator": "mirror.metrics.detection.nuscenes",
        "NuScenesDetection": "mirror.metrics.detection.nuscenes",
        "PerceptualDistance": "mirror.metrics.features.perceptual",
        "Psnr": "mirror.metrics.images.psnr",
        "PsnrSummary": "mirror.metrics.images.psnr",
        "RankIntervals": "mirror.metrics.ranks",
        "RegionIou": "mirror.metrics.boxes.iou_2d",
        "Score": "mirror.metrics.score",
        "Ssim": "mirror.metrics.images.ssim",
        "SsimSettings": "mirror.metrics.images.ssim_map",
        "Summary": "mirror.metrics.images.aggregate",
        "VideoFeatures": "mirror.metrics.features.fvd",
        "box_iou_2d": "mirror.metrics.boxes.iou_2d",
        "box_iou_3d": "mirror.metrics.boxes.iou_3d",
        "box_iou_3d_matrix": "mirror.metrics.boxes.iou_3d",
        "by_group": "mirror.metrics.images.aggregate",
        "correct_colours": "mirror.metrics.images.colour_correction",
        "extract": "mirror.metrics.features.extractor",
        "fid": "mirror.metrics.features.fid",
        "fid_of_features": "mirror.metrics.features.fid",
        "frame_blocks": "mirror.metrics.images.bootstrap",
        "frechet_distance": "mirror.metrics.features.frechet",
        "fvd": "mirror.metrics.features.fvd",
        "hull_iou": "mirror.metrics.boxes.iou_2d",
        "kid": "mirror.metrics.features.kid",
        "load_i3d": "mirror.metrics.features.fvd",
        "load_inception": "mirror.metrics.features.fid",
        "load_lpips": "mirror.metrics.features.lpips",
        "load_st_lpips": "mirror.metrics.features.st_lpips",
        "lpips": "mirror.metrics.features.lpips",
        "mask_iou": "mirror.metrics.boxes.iou_2d",
        "mean_interval": "mirror.metrics.images.bootstrap",
        "matched_structure": "mirror.metrics.images.matched_structure",
        "ms_structure": "mirror.metrics.images.structure",
        "nuscenes_detection": "mirror.metrics.detection.nuscenes",
        "paired_difference": "mirror.metrics.images.bootstrap",
        "polygon_mask": "mirror.metrics.boxes.raster",
        "psnr": "mirror.metrics.images.psnr",
        "psnr_affine": "mirror.metrics.images.affine",
        "psnr_cc": "mirror.metrics.images.colour_correction",
        "psnr_invariant": "mirror.metrics.images.invariant",
        "rank_intervals": "mirror.metrics.ranks",
        "ssim": "mirror.metrics.images.ssim",
        "ssim_map": "mirror.metrics.images.ssim",
        "st_lpips": "mirror.metrics.features.st_lpips",
        "summarise": "mirror.metrics.images.aggregate",
        "visible_share": "mirror.metrics.boxes.projected",
    },
)
