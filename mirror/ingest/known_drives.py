"""The drives that a dataset has already, by the newest snapshot of its index: no drive is opened for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mirror.dataset.index.snapshots import read_state
from mirror.dataset.store import Store
from mirror.errors import DatasetError, SchemaError
from mirror.schema.snapshot import DriveSource


@dataclass(frozen=True)
class KnownDrives:
    """The drives of a dataset that its index names and whose folders are there.

    A list of the folders shows what was lost as a whole. What was damaged inside is found by `mirror check`, and by a
    run that verifies.

    Attributes:
        sources: what each was made from, by drive id.
        is_final: no drive is ever replaced.
    """

    sources: Mapping[str, DriveSource] = field(default_factory=dict)
    is_final: bool = False

    @classmethod
    def read(cls, store: Store) -> KnownDrives:
        """Read the newest snapshot, and list the folders of drives and traversals; one without an index knows none."""
        try:
            state = read_state(store)
        except (DatasetError, SchemaError):
            # Each drive is then opened and held against its manifest; `mirror index` mends the index.
            return cls()
        if state is None:
            return cls()
        drives, traversals = (frozenset(store.list_folders(name)) for name in ("drives", "traversals"))
        return cls(
            {
                drive_id: source
                for drive_id, source in state.sources.drives.items()
                if drive_id in drives and traversals.issuperset(source.traversals)
            },
            store.folder is None,
        )

    def has_unchanged(self, drive_id: str, fingerprint: str, configuration: str, scenes: set[str]) -> bool:
        """Return whether a drive was made from this recording, with these options, and judged for these scenes."""
        known = self.sources.get(drive_id)
        return (
            known is not None
            and (known.source, known.configuration) == (fingerprint, configuration)
            and scenes.issubset(known.scenes)
        )
