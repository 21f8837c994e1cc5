"""A dataparser of nerfstudio that opens a dataset without an export: ``ns-train METHOD mirror-data --data DATASET``.

nerfstudio finds it through the entry point ``mirror-data`` and is imported only then. Images are the dataset's own
files. The lenses must be those that nerfstudio has; otherwise export the dataset with ``--undistort``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from mirror.dataset.dataset import open as open_dataset
from mirror.export.gsplat_parser import local_path
from mirror.export.lenses import nerfstudio_lens, require_lenses
from mirror.export.mask_files import write_mask_files
from mirror.export.nerfstudio import ROLES, opengl_pose
from mirror.export.scene import ExportImage, ExportScene, select_scene

_base: Any = import_module("nerfstudio.data.dataparsers.base_dataparser")
_cameras: Any = import_module("nerfstudio.cameras.cameras")
_registry: Any = import_module("nerfstudio.plugins.registry_dataparser")
_scene_box: Any = import_module("nerfstudio.data.scene_box")

_ORDER = ("k1", "k2", "k3", "k4", "p1", "p2")


@dataclass
class MirrorDataParserConfig(_base.DataParserConfig):
    """Settings of the nerfstudio dataparser.

    Attributes:
        data: folder of the dataset.
        scene: id of the scene; None: the only one.
        camera: names of the cameras; empty: all.
        split: split whose roles are used; None: every eighth image is for evaluation.
        masks: give nerfstudio the masks of road users and the recording vehicle, as files of a temporary folder.
    """

    _target: type = field(default_factory=lambda: MirrorDataParser)
    data: Path = Path()
    scene: str | None = None
    camera: tuple[str, ...] = ()
    split: str | None = None
    masks: bool = True


@dataclass
class MirrorDataParser(_base.DataParser):
    """A dataparser that opens a scene of a dataset for nerfstudio."""

    config: MirrorDataParserConfig

    def _generate_dataparser_outputs(self, split: str = "train", **_: Any) -> Any:
        import torch

        dataset = open_dataset(self.config.data).where(camera=self.config.camera or None)
        selected = select_scene(dataset, self.config.scene, self.config.split, undistort=False)
        require_lenses("nerfstudio", selected.images, nerfstudio_lens)
        images = _of_split(selected, split)
        poses = np.stack([opengl_pose(item, selected.origin_m) for item in images])
        lenses = [nerfstudio_lens(item.lens) for item in images]
        fisheye = [lens is not None and lens.model == "OPENCV_FISHEYE" for lens in lenses]
        kinds = [_cameras.CameraType.FISHEYE if wide else _cameras.CameraType.PERSPECTIVE for wide in fisheye]
        coefficients = [
            [0.0 if lens is None else lens.coefficients.get(name, 0.0) for name in _ORDER] for lens in lenses
        ]

        def column(name: str) -> Any:
            return torch.tensor([getattr(item.lens, name) for item in images])

        cameras = _cameras.Cameras(
            camera_to_worlds=torch.from_numpy(poses[:, :3].astype(np.float32)),
            fx=column("fx_px"), fy=column("fy_px"), cx=column("cx_px"), cy=column("cy_px"),
            width=column("width_px"), height=column("height_px"),
            distortion_params=torch.tensor(coefficients, dtype=torch.float32),
            camera_type=torch.tensor([kind.value for kind in kinds])[:, None],
        )  # fmt: skip
        metadata: dict[str, Any] = {}
        if selected.points is not None:
            metadata["points3D_xyz"] = torch.from_numpy(
                (selected.points.position_m - selected.origin_m).astype(np.float32)
            )
            metadata["points3D_rgb"] = torch.from_numpy(selected.points.rgb)
        reach = float(np.abs(poses[:, :3, 3]).max()) + 1.0
        transform = torch.eye(4)[:3]
        transform[:, 3] = -torch.from_numpy(selected.origin_m)
        return _base.DataparserOutputs(
            image_filenames=[Path(local_path(dataset, item)) for item in images],
            mask_filenames=write_mask_files(images) if self.config.masks else None,
            cameras=cameras,
            scene_box=_scene_box.SceneBox(aabb=torch.tensor([[-reach] * 3, [reach] * 3])),
            dataparser_transform=transform,
            metadata=metadata,
        )


def _of_split(selected: ExportScene, split: str) -> list[ExportImage]:
    if selected.split is not None:
        return [item for item in selected.images if item.role in ROLES[split]]
    is_test = [number % 8 == 0 for number in range(len(selected.images))]
    return [item for item, test in zip(selected.images, is_test) if test == (split != "train")]


MIRROR = _registry.DataParserSpecification(
    config=MirrorDataParserConfig(), description="A scene of a MIRROR dataset, without an export"
)
