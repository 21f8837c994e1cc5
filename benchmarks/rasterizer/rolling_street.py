"""Trains Gaussians on a street that was recorded at 15 m/s, with a rolling and with a global shutter.

The same views of the same street (`mirror.synth`), of cameras that look aside: with a global shutter, with a readout
of 30 ms that is modelled, and with a readout that is ignored. All three go through the unscented path, from as many
points on the surfaces that their poses give, with the same steps. PSNR is that of held-out views against exact images.

Declared before it ran: three stretches of 2 s at 14.6 to 16 m/s, 20 images of 192x108 each of which 5 are held out,
22,500 points, 1500 steps. The bar is that of the mean of the three stretches. This is about 10 core-minutes of the
4 core-hours that the comparison may take, because the machine is shared. A PSNR is kept in ``benchmarks/out`` by the
hash of all that it comes from: a run that was stopped continues with the same command.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
import torch
from torch import Tensor

from benchmarks.report import OUT, Row
from hybridworldsim.rasterizer import RollingShutterType, rasterization
from mirror.arrays import Float32, Float64, UInt8
from mirror.geometry import Poses, rotate
from mirror.geometry.cameras import Camera
from mirror.geometry.rolling_shutter import RollingShutter
from mirror.synth import Effects, SynthDrive, make_drives, make_lens

READOUT_NS: Final = 30_000_000
LOSS_BAR_DB: Final = 0.3
"""PSNR with a rolling shutter that is modelled, below that with a global one."""

_FRAMES, _PERIOD_S, _HELD_OUT = 20, 0.1, 4
_FARTHEST_M: Final = 80.0
_EFFECTS: Final = ("noise", "motion_blur", "traffic")
_RATES: Final = {"means": 2e-3, "quats": 1e-2, "scales": 1e-2, "opacities": 5e-2, "colors": 2e-2, "background": 1e-2}


class Stretch(NamedTuple):
    """A camera on a stretch of a drive of the preset benchmark on which the vehicle drives about 15 m/s, by day."""

    drive: int
    first_s: float
    camera: str


class Scale(NamedTuple):
    """The size of a comparison.

    Attributes:
        stretches: where the images are taken.
        lens: lens of the camera.
        points: points of an image.
        steps: steps of a training.
    """

    stretches: tuple[Stretch, ...]
    lens: Camera
    points: int
    steps: int


DECLARED: Final = Scale(
    (Stretch(18, 6.6, "front_left"), Stretch(18, 6.6, "front_right"), Stretch(22, 2.0, "front_left")),
    Camera("pinhole", 192, 108, 120.0, 120.0, 96.0, 54.0),
    1500,
    1500,
)
QUICK: Final = Scale(DECLARED.stretches[:1], Camera("pinhole", 128, 72, 80.0, 80.0, 64.0, 36.0), 700, 60)


class Recorded(NamedTuple):
    """One image, its distances, and the poses of the camera at its first row, in the middle and at its last row."""

    bgr: UInt8  # (H, W, 3)
    distance_m: Float32  # (H, W)
    world_SE3_camera: Poses  # three


class View(NamedTuple):
    """The part of an image that training is given: colours, the poses of its first and last rows, and points."""

    rgb: Tensor  # (H, W, 3)
    ends: tuple[Tensor, Tensor]  # camera_SE3_world
    points: Tensor  # (P, 7): place, colour, distance
    lens: Camera


def street_rows(quick: bool, repeats: int) -> Iterator[Row]:
    """Yield the PSNR of held-out views for the three ways, of each stretch and in the mean."""
    del repeats
    scale = QUICK if quick else DECLARED
    drives = make_drives("benchmark", 0)[1]
    size = f"{_FRAMES} of {scale.lens.width_px}x{scale.lens.height_px}, {scale.steps} steps"
    found: dict[str, list[float]] = {}
    for stretch in scale.stretches:
        drive = drives[stretch.drive]
        drive = replace(drive, condition=replace(drive.condition, effects=Effects.without(list(_EFFECTS))))
        origin = drive.truth.poses(np.array([stretch.first_s])).translation[0]
        still, rolling = (_record(drive, stretch, scale.lens, readout_ns) for readout_ns in (0, READOUT_NS))
        for name, images, modelled in (
            ("global", still, True),
            ("rolling, modelled", rolling, True),
            ("rolling, ignored", rolling, False),
        ):
            psnr = _kept_psnr([_to_view(one, scale, modelled, origin) for one in images], scale.steps)
            found.setdefault(name, []).append(psnr)
            yield Row(f"street {stretch.drive} {stretch.camera}, {name} (PSNR, dB)", size, psnr)
    lost = {name: float(np.mean(found["global"]) - np.mean(values)) for name, values in found.items()}
    yield Row("street, loss by a shutter that is modelled (dB)", size, lost["rolling, modelled"], bar=LOSS_BAR_DB)
    yield Row("street, loss by a shutter that is ignored (dB)", size, lost["rolling, ignored"])


def _kept_psnr(views: Sequence[View], steps: int) -> float:
    """Return the PSNR of a training, which is kept by the hash of its views and settings."""
    content = hashlib.sha256(repr((steps, _HELD_OUT, sorted(_RATES.items()))).encode())
    for view in views:
        for tensor in (view.rgb, *view.ends, view.points):
            content.update(tensor.numpy().tobytes())
    path = OUT / "rolling-street" / f"{content.hexdigest()[:16]}.json"
    if path.is_file():
        return float(json.loads(path.read_text())["psnr_db"])
    psnr = _train(views, steps)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"psnr_db": psnr}))
    return psnr


def _record(drive: SynthDrive, stretch: Stretch, camera: Camera, readout_ns: int) -> list[Recorded]:
    """Render the images of a stretch."""
    lens, scene, mounting = make_lens(camera), drive.stage, drive.vehicle.ego_SE3_camera[stretch.camera]
    shutter = RollingShutter("top_to_bottom", readout_ns, camera.width_px, camera.height_px)
    out = []
    for number in range(_FRAMES):
        time_s = stretch.first_s + _PERIOD_S * number
        egos = drive.truth.poses(time_s + 0.5e-9 * readout_ns * np.array([-1.0, 0.0, 1.0]))
        instant = scene.at(time_s, egos[1:2])
        if not readout_ns:
            image = scene.render(instant, lens, egos[1:2] @ mounting)
            out.append(Recorded(image.bgr, image.view.distance_m, egos @ mounting))
            continue
        times_s = time_s + 1e-9 * shutter.line_offsets_ns()
        poses = drive.truth.poses(times_s)
        rolled = scene.render_lines(instant, lens, times_s, poses, poses @ mounting, columns=False)
        out.append(Recorded(rolled.bgr, rolled.view.distance_m, egos @ mounting))
    return out


def _to_view(image: Recorded, scale: Scale, modelled: bool, origin: Float64) -> View:
    """Make a view; without a model of the shutter all rows, also those of the points, have the pose of the middle."""
    poses = image.world_SE3_camera
    rows = poses if modelled else poses[np.ones(3, np.int64)]
    rng = np.random.default_rng(0)
    near = np.argwhere(image.distance_m < _FARTHEST_M)
    chosen = near[rng.permutation(len(near))[: scale.points]]
    share = chosen[:, 0] / (scale.lens.height_px - 1)
    distance = image.distance_m[chosen[:, 0], chosen[:, 1]].astype(np.float64)
    place = rows.translation[0] + share[:, None] * (rows.translation[2] - rows.translation[0])
    directions = rotate(rows.rotation[1][None], scale.lens.rays().direction[chosen[:, 0], chosen[:, 1]])
    rgb = image.bgr[..., ::-1].astype(np.float32) / 255.0
    points = np.column_stack(
        [
            place + distance[:, None] * directions - origin,
            rgb[chosen[:, 0], chosen[:, 1]],
            distance,
            np.ones(len(chosen)),
        ]
    )
    ends = tuple(_to_viewmat(rows[at : at + 1], origin) for at in (0, 2))
    return View(
        torch.from_numpy(rgb.copy()), (ends[0], ends[1]), torch.from_numpy(points.astype(np.float32)), scale.lens
    )


def _to_viewmat(pose: Poses, origin: Float64) -> Tensor:
    """Convert a pose to camera_SE3_world (4, 4), about an origin."""
    return torch.from_numpy(Poses(pose.rotation, pose.translation - origin).inverse().matrix()[0].astype(np.float32))


def _train(views: Sequence[View], steps: int) -> float:
    """Train on all views but the held-out ones, and return the mean PSNR of these, dB."""
    torch.manual_seed(0)
    trained = [view for number, view in enumerate(views) if number % _HELD_OUT != 2]
    held_out = [view for number, view in enumerate(views) if number % _HELD_OUT == 2]
    points = torch.cat([view.points for view in trained])
    focal_px = trained[0].lens.fx_px
    tables = {
        "means": points[:, :3].clone(),
        "quats": torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(len(points), 1),
        "scales": (points[:, 6:7] / focal_px).clamp(0.02, 1.0).log().repeat(1, 3),
        "opacities": torch.full((len(points),), 0.5),
        "colors": torch.logit(points[:, 3:6].clamp(0.02, 0.98)),
        "background": torch.zeros(3),
    }
    for table in tables.values():
        table.requires_grad_()
    optimizer = torch.optim.Adam([{"params": [tables[name]], "lr": rate} for name, rate in _RATES.items()], eps=1e-15)
    order = torch.randint(len(trained), (steps,), generator=torch.Generator().manual_seed(1)).tolist()
    for step, number in enumerate(order):
        for group, rate in zip(optimizer.param_groups, _RATES.values(), strict=True):
            group["lr"] = rate * 0.1 ** (step / steps)
        optimizer.zero_grad(set_to_none=True)
        loss = (_render(tables, trained[number]) - trained[number].rgb).abs().mean()
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        errors = [(_render(tables, view).clamp(0.0, 1.0) - view.rgb).square().mean() for view in held_out]
    return float(np.mean([-10.0 * np.log10(float(error)) for error in errors]))


def _render(tables: dict[str, Tensor], view: View) -> Tensor:
    """Render the colours (H, W, 3) of a view."""
    images, _, _ = rasterization(
        tables["means"], tables["quats"], tables["scales"].exp(), tables["opacities"].sigmoid(),
        tables["colors"].sigmoid(), view.ends[0][None], torch.from_numpy(view.lens.intrinsic_matrix()).float()[None],
        view.lens.width_px, view.lens.height_px, near_plane=0.2, backgrounds=tables["background"].sigmoid()[None],
        with_ut=True, rolling_shutter=RollingShutterType.ROLLING_TOP_TO_BOTTOM,
        viewmats_rs=view.ends[1][None],
    )  # fmt: skip
    return images[0]
