"""Finds the poses of a recording by structure from motion, and writes recordings that have them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from mirror.arrays import Int64
from mirror.calibration.statistics import require_scipy
from mirror.errors import UsageError
from mirror.installation import install_command
from mirror.localisation.structure.inputs import DriveInputs
from mirror.localisation.structure.maps import ImageMap, MappedImages, map_images, sequence_partners
from mirror.localisation.structure.options import StructureOptions
from mirror.localisation.structure.placing import PartPlacer
from mirror.localisation.structure.report import PartReport, PosesReport, describe_part
from mirror.localisation.structure.used_images import StaticPixels, UsedImages, choose_images
from mirror.progress import NullProgress, ProgressReporter
from mirror.recordings.assembly.derived import DerivedRecording, write_derived
from mirror.recordings.protocol import Recording
from mirror.recordings.time import SECOND_NS

REPORT_NAME: Final = "poses.json"
_NEAR_M: Final = 12.0
_LOOPS: Final = 4
"""Number of images of an earlier way that an image is matched with, where the fixes say that it comes back."""


def require_pycolmap() -> None:
    """Require the package that maps; called before minutes are spent on images.

    Raises:
        UsageError: pycolmap is not installed.
    """
    try:
        import pycolmap  # noqa: F401
    except ModuleNotFoundError as error:
        raise UsageError("structure from motion needs pycolmap", remedy=install_command("calibration")) from error


def find_poses(
    recording: Recording,
    source: Path,
    out: Path,
    options: StructureOptions,
    progress: ProgressReporter | None = None,
    *,
    parts_in: Path | None = None,
) -> PosesReport:
    """Register the images of one camera of a recording, and write a recording with poses for each part of the drive.

    One part is written to ``out`` itself, several to ``DRIVE_1``, ``DRIVE_2`` in ``parts_in``. Only registered images
    of the camera are in it; images of other cameras are, where their time lies within the part.

    Args:
        recording: the recording, with or without poses. Of its poses only positions are used.
        source: its path, for messages.
        out: a new folder.
        options: settings.
        progress: receives the phases and their progress.
        parts_in: folder of the recordings of several parts; None: ``out``.

    Raises:
        UsageError: too few images can be registered, or there is nothing that gives the scale.
        RecordingError: the recording cannot be read.
        DatasetError: a file cannot be written.
    """
    require_pycolmap()
    require_scipy()
    registration = _Registration(DriveInputs(recording, source, options), progress or NullProgress())
    return registration.run(out, parts_in or out)


def _rename(made: DerivedRecording, report: PartReport, drive: str, out: Path) -> tuple[DerivedRecording, PartReport]:
    """Give the only part of a drive the id of the drive and the folder of the output."""
    frame = drive if made.info.frame == made.info.drive_id else made.info.frame
    info = replace(made.info, drive_id=drive, frame=frame)
    return replace(made, info=info), replace(report, recording=out)


class _Registration:
    """The registration of one recording."""

    def __init__(self, inputs: DriveInputs, progress: ProgressReporter) -> None:
        self.inputs, self.options, self.progress = inputs, inputs.options, progress
        self.report = PosesReport(inputs.source, inputs.camera.info.name)

    def run(self, out: Path, parts_in: Path) -> PosesReport:
        """Register, and write the parts."""
        options, report = self.options, self.report
        images = self._read_images()
        report.read, report.used = images.total, len(images)
        if len(images) < options.least_images:
            raise UsageError(
                f"{len(images)} of {images.total} images move", file=self.inputs.source,
                place=f"camera {report.camera}", expected=f"at least {options.least_images}",
                remedy="give a smaller --motion-percent",
            )  # fmt: skip
        self.progress.start(f"{self.inputs.source.name}: map", len(images))
        size = images.width_px, images.height_px
        mapped = MappedImages(images.features, np.zeros(len(images), np.int64), [self.inputs.camera.lens], [size])
        partners = sequence_partners(len(images), options.neighbours, self._near_pairs(images))
        maps, report.matched = map_images(mapped, partners, self.progress.advance)
        parts = [part for one in maps for part in self._split(images, one)]
        parts.sort(key=lambda one: int(one.used[0]))
        large = [part for part in parts if len(part.used) >= options.least_images]
        small = [part for part in parts if len(part.used) < options.least_images]
        report.refused += [f"{describe_part(images, part)}: fewer than {options.least_images}" for part in small]
        registered = sum(len(part.used) for part in large)
        if not large or registered < options.least_share * len(images):
            raise UsageError(
                f"{registered} of {len(images)} used images could be registered", file=self.inputs.source,
                place=f"camera {report.camera}", expected=f"at least {options.least_share:.0%}",
                remedy="give a smaller --motion-percent so that neighbours overlap more, --lens if the lens is unknown,"
                " --masks of road users, or accept less by --least-share",
            )  # fmt: skip
        if self.inputs.scale == "length" and len(large) > 1:
            raise UsageError(
                f"the drive is cut into {len(large)} parts, and one length does not give their scales",
                file=self.inputs.source, place="--length-m", expected="one part",
                remedy="take --camera-height-m METRES, or give a smaller --motion-percent",
            )  # fmt: skip
        placer, made = PartPlacer(self.inputs, self.progress), list[tuple[DerivedRecording, PartReport]]()
        drive = self.inputs.recording.info.drive_id
        for number, part in enumerate(large):
            try:
                made.append(placer.place(images, part, f"{drive}_{number + 1}", parts_in / f"{drive}_{number + 1}"))
            except UsageError as error:
                if len(large) == 1:
                    raise
                report.refused.append(f"{describe_part(images, part)}: {error}")
        if len(made) == 1:
            made = [_rename(*made[0], drive, out)]
        if not made:
            raise UsageError(
                "no part of the drive has a scale", file=self.inputs.source, expected="; ".join(report.refused),
                remedy="take the scale from elsewhere: --camera-height-m METRES or --length-m METRES",
            )  # fmt: skip
        for derived, part_report in made:
            document = (json.dumps(part_report.to_dict(), indent=1) + "\n").encode()
            write_derived(part_report.recording, replace(derived, documents={REPORT_NAME: document}))
        report.parts = [part_report for _, part_report in made]
        return report

    def _read_images(self) -> UsedImages:
        options, camera = self.options, self.inputs.camera
        mounted = None
        if camera.lens is not None and camera.ego_SE3_camera is not None:
            mounted = camera.lens, camera.ego_SE3_camera
        still = StaticPixels(self.inputs.recording, camera.info, mounted, options.masks)
        stream = self.inputs.streams[camera.info.name]
        self.progress.start(f"{self.inputs.source.name}: images", len(stream.exposure_start_ns))
        images = choose_images(
            stream, still, options.motion_percent, options.longest_step_s, options.features, self.progress.advance
        )
        self.report.hidden = still.hidden
        lens, size = camera.lens, (images.width_px, images.height_px)
        if lens is not None and (lens.width_px, lens.height_px) != size:
            raise UsageError(
                f"the lens has {lens.width_px} x {lens.height_px} px, the images {size[0]} x {size[1]}",
                file=self.inputs.source, place=f"camera {camera.info.name}", expected="a lens of that size",
            )  # fmt: skip
        return images

    def _near_pairs(self, images: UsedImages) -> Int64:
        """Return the pairs (N, 2) of images that a track has near each other, some time apart: loops."""
        if self.inputs.fixes is None:
            return np.zeros((0, 2), np.int64)
        places, known = self.inputs.fixes.at(images.time_ns)
        numbers = np.flatnonzero(known)
        pairs = []
        for row, one in enumerate(numbers.tolist()):
            later = numbers[row + 1 :]
            apart = np.linalg.norm(places[later, :2] - places[one, :2], axis=1)
            far = later[(apart < _NEAR_M) & (later > one + 3 * self.options.neighbours)]
            pairs += [(one, other) for other in far[:: max(1, len(far) // _LOOPS)].tolist()]
        return np.array(pairs, np.int64).reshape(-1, 2)

    def _split(self, images: UsedImages, one: ImageMap) -> list[ImageMap]:
        """Cut a map where no image is registered for longer than allowed; shorter gaps are bridged by it."""
        stamps = images.time_ns[one.used]
        steps = np.diff(stamps) / SECOND_NS
        cuts = np.flatnonzero(steps > self.options.longest_gap_s) + 1
        missing = np.diff(one.used) > 1
        self.report.bridged_s += [
            round(float(gap), 2) for gap, lost in zip(steps, missing) if lost and gap <= self.options.longest_gap_s
        ]
        parts = []
        for own in np.split(np.arange(len(stamps)), cuts):
            observed = [one.observed[place] for place in own.tolist()]
            parts.append(
                replace(one, used=one.used[own], world_SE3_camera=one.world_SE3_camera[own], observed=observed)
            )
        return parts
