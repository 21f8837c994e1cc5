"""The track of a recording as ingest takes it: an error where too many of its rows make no pose."""

from __future__ import annotations

from mirror.ingest.usable import clean_usable
from mirror.recordings.protocol import Recording, Track
from mirror.schema.documents import CleaningOptions, TriggerOptions


def clean_track(recording: Recording) -> Track:
    """The track without bad rows, of which there are few."""
    info = recording.info
    return clean_usable(recording.track(), CleaningOptions(), TriggerOptions(), is_clip=info.is_clip)[0]
