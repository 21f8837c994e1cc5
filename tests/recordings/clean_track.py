"""The track of a recording after the checks of ingest: too many bad rows are an error."""

from __future__ import annotations

from mirror.ingest.usable import clean_usable
from mirror.recordings.protocol import Recording, Track
from mirror.schema.documents import CleaningOptions, TriggerOptions


def clean_track(recording: Recording) -> Track:
    """Read the track without bad rows; raise if there are too many."""
    info = recording.info
    return clean_usable(recording.track(), CleaningOptions(), TriggerOptions(), is_clip=info.is_clip)[0]
