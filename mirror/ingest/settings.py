"""What a run is held to: the dataset's thresholds and scenes, with what the run adds, and their hash."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mirror.dataset.layout import Layout
from mirror.errors import DatasetError, UsageError
from mirror.ingest.request import IngestOptions, validate_thresholds
from mirror.ingest.rois import merge_rois, read_rois
from mirror.ingest.trigger import RoiTrigger
from mirror.schema.documents import CleaningOptions, DatasetDocument, Roi, TriggerOptions
from mirror.schema.files import read_json
from mirror.schema.hashing import hash_document
from mirror.schema.version import SCHEMA_VERSION


@dataclass(frozen=True)
class IngestSettings:
    """Settings by which every drive of a run is judged and written.

    Attributes:
        document: ``dataset.json``.
        rois: all scenes.
        configuration: hash of the options that decide what is written.
    """

    document: DatasetDocument
    rois: tuple[Roi, ...]
    configuration: str

    @property
    def scenes(self) -> set[str]:
        """Ids of all scenes."""
        return {roi.scene_id for roi in self.rois}

    def trigger(self) -> RoiTrigger:
        """Return the trigger for all scenes."""
        return RoiTrigger(self.rois, self.document.trigger, self.document.cleaning)


def merge_settings(layout: Layout, options: IngestOptions, rois: Sequence[Roi]) -> IngestSettings:
    """Merge the settings of a run into the settings of the dataset.

    Raises:
        UsageError: there is no ROI, or a threshold is out of its range.
        DatasetError: the run contradicts the dataset.
    """
    given_trigger, given_cleaning = dict(options.trigger), dict(options.cleaning)
    present: list[Roi] = []
    if layout.document.exists():
        document = read_json(layout.document, DatasetDocument)
        for given, own in ((given_trigger, document.trigger), (given_cleaning, document.cleaning)):
            for name, value in given.items():
                if getattr(own, name) != value:
                    raise DatasetError(
                        f"{name} {value} differs from the dataset's {getattr(own, name)}",
                        file=layout.document,
                        expected="one set of thresholds for all passes of a dataset",
                        remedy=f"leave --{name.replace('_', '-')} out, or ingest everything into a new folder",
                    )
        if options.licence not in (None, document.licence):
            raise DatasetError(
                f"licence {options.licence!r} differs from the dataset's {document.licence!r}",
                file=layout.document,
                remedy="leave --licence out, or ingest into a new folder",
            )
        present = read_rois(layout.rois) if layout.rois.exists() else []
    else:
        document = DatasetDocument(
            licence=options.licence,
            trigger=validate_thresholds(TriggerOptions, given_trigger),
            cleaning=validate_thresholds(CleaningOptions, given_cleaning),
        )
    merged = merge_rois(present, rois, layout.rois)
    if not merged:
        raise missing_roi_error()
    return IngestSettings(document, tuple(merged), _configuration(document, options))


def missing_roi_error() -> UsageError:
    """Make the error for a run without a scene to cut out."""
    return UsageError("no ROI given", expected="--rois FILE or --roi lon,lat", remedy="see `mirror rois propose`")


def _configuration(document: DatasetDocument, options: IngestOptions) -> str:
    decisive: dict[str, object] = {
        "schema_version": SCHEMA_VERSION,
        "trigger": document.trigger.model_dump(mode="json"),
        "cleaning": document.cleaning.model_dump(mode="json"),
        "reader": options.reader,
        "reader_options": dict(options.reader_options),
        "hashing": options.write.hashing,
        "weather_plugin": options.weather_plugin,
    }
    if options.write.videos != "jpeg":
        # Absent for the default, so that datasets of earlier versions keep their hash.
        decisive["videos"] = options.write.videos
    if options.write.shards:
        decisive["shards"] = True
    if options.write.references != "size":
        decisive["references"] = options.write.references
    if options.max_missing_images:
        decisive["max_missing_images"] = options.max_missing_images
    return hash_document(decisive)
