"""Opening a dataset, and lazy views of it. A view collects filters; reading fetches only the rows that pass them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeAlias, get_args

import pyarrow as pa
import pyarrow.compute as pc

from mirror.dataset.index.snapshots import read_snapshot
from mirror.dataset.layers import LayerChoice
from mirror.dataset.layout import Layout
from mirror.dataset.opening import hash_snapshot, open_snapshot, read_document
from mirror.dataset.query.catalog import TABLES, Catalog
from mirror.dataset.query.choices import parse_interval, require_known
from mirror.dataset.query.filters import Circle, Filters, LocalCircle
from mirror.dataset.query.select import count_rows, read_rows
from mirror.dataset.split_document import read_split
from mirror.dataset.store import Store, store_at
from mirror.errors import DatasetError, UsageError
from mirror.schema.documents import (
    CANONICAL_CAMERAS,
    DatasetDocument,
    Roi,
    Role,
)

if TYPE_CHECKING:
    import pandas as pd

    from mirror.dataset.frames import FrameSequence
    from mirror.dataset.image import Image
    from mirror.dataset.points import Points
    from mirror.schema.road_map import RoadMap

Choice: TypeAlias = str | Iterable[str] | None
Within: TypeAlias = tuple[float, float, float] | tuple[float, float, float, str]

_LIGHT = ("day", "dusk", "night")
_WEATHER = ("clear", "clouds", "rain", "snow", "fog", "unknown")


@dataclass(frozen=True, eq=False, repr=False)
class Dataset:
    """A dataset or a part of it: an immutable view that reads a table only when a method needs it.

    `open` makes it. It can be pickled; another process then opens the same index. A view of a local dataset reads the
    state at the time of opening, even while a run replaces drives: replaced files stay on disk as long as a view needs
    them. A view reads one snapshot of the index, whatever is added meanwhile.

    Attributes:
        document: ``dataset.json``.
        filters: the restrictions of the view.
        layers: the layers of poses, calibrations, boxes, depth and points that the view reads.
        snapshot: number of the snapshot of the index that the view reads.
        index_sha256: hash of what the snapshot holds; equal for equal datasets whose index is compact.
    """

    document: DatasetDocument
    filters: Filters
    layers: LayerChoice
    snapshot: int
    index_sha256: str
    _catalog: Catalog

    @property
    def root(self) -> str:
        """The path or URL that was opened."""
        return self._catalog.store.root

    @property
    def store(self) -> Store:
        """Access to the dataset's files."""
        return self._catalog.store

    @property
    def catalog(self) -> Catalog:
        """The index; all views share it."""
        return self._catalog

    @property
    def layout(self) -> Layout:
        """The paths of a local dataset.

        Raises:
            UsageError: the dataset was opened from a URL.
        """
        if self.store.folder is None:
            raise UsageError(
                "a dataset that is not in a folder of this machine is read only", file=self.root, expected="a folder",
                remedy=f"bring a part to this machine: mirror dataset fetch {self.root} --scene ID --out FOLDER",
            )  # fmt: skip
        return Layout(self.store.folder)

    def __repr__(self) -> str:
        return f"Dataset({self.root!r}: {self.count('traversals')} traversals, {self.count('images')} images)"

    def _repr_html_(self) -> str:
        """Return the dataset as HTML for notebooks: a strip of thumbnails and a table of its contents."""
        from mirror.dataset.notebook import show_dataset

        def middle_images(traversal: str) -> Mapping[str, Image]:
            frames = self.where(traversal=traversal).frames()
            return frames[len(frames) // 2].images

        rows = self.table("traversals").to_pylist()
        facts = {
            "folder": self.root,
            "scenes": ", ".join(self.scenes()),
            "traversals": f"{len(rows):,} of {len(self.drives()):,} drives",
            "cameras": ", ".join(self.cameras()),
            **{name: f"{self.count(name):,}" for name in ("frames", "images", "boxes")},
        }
        return show_dataset(facts, rows, middle_images)

    def __reduce__(self) -> tuple[Callable[..., Dataset], tuple[object, ...]]:
        return (_reopen, (self.root, self.snapshot, self.index_sha256, self.filters, self.layers))

    def scenes(self) -> list[str]:
        """Return the ids of the scenes in the view, sorted."""
        return self._column("scenes", "scene_id")

    def traversals(self) -> list[str]:
        """Return the ids of the traversals in the view, sorted by scene and id."""
        return self._column("traversals", "traversal_id")

    def drives(self) -> list[str]:
        """Return the ids of the drives with a traversal in the view, sorted."""
        return sorted(set(self._column("traversals", "drive_id")))

    def roles(self, split: str) -> list[str]:
        """Return the roles of the view's traversals in a split, sorted.

        Raises:
            DatasetError: the split does not exist.
            UsageError: the name is not a valid name of a split.
        """
        assignments = self._assignments(split)
        return sorted({assignments[key] for key in self.traversals() if key in assignments})

    def cameras(self) -> list[str]:
        """Return the names of cameras with images in the view: canonical ones first, then the others, sorted."""
        names = {name for cameras in self._column("traversals", "cameras") for name in cameras}
        chosen = names if self.filters.camera is None else names & self.filters.camera
        canonical = [name for name in CANONICAL_CAMERAS if name in chosen]
        return [*canonical, *sorted(chosen - set(canonical))]

    def passes(self) -> pa.Table:
        """Return the ledger: every pass, accepted or refused, with the rule that decided."""
        return self.table("passes")

    def where(
        self,
        *,
        scene: Choice = None,
        traversal: Choice = None,
        drive: Choice = None,
        camera: Choice = None,
        vehicle: Choice = None,
        light: Choice = None,
        weather: Choice = None,
        time: tuple[int, int] | None = None,
        within: Within | None = None,
        split: str | None = None,
        role: Choice = None,
        withheld: bool | None = None,
    ) -> Dataset:
        """Make a view with further restrictions, in addition to the restrictions of this view.

        In a table with a timestamp, a place or a camera, each row is filtered by it. A table without them keeps the
        rows of the traversals that pass. A traversal passes ``time`` if the interval from entry to exit overlaps it,
        and ``within`` if its driven line has a point in the circle.

        Args:
            scene: id or ids.
            traversal: id or ids.
            drive: id or ids.
            camera: name or names.
            vehicle: pseudonym or pseudonyms.
            light: ``day``, ``dusk`` or ``night``.
            weather: ``clear``, ``clouds``, ``rain``, ``snow``, ``fog`` or ``unknown``.
            time: start (included) and end (excluded), Unix ns.
            within: circle (longitude_deg, latitude_deg, radius_m) on the ellipsoid, its edge included; or
                (x_m, y_m, radius_m, frame) in a local metric frame.
            split: name of a split.
            role: role or roles in the split; None: every traversal with a role.
            withheld: True: images that a published dataset withholds, and frames with such an image of the view's
                cameras; False: the others. Other tables keep their rows.

        Raises:
            UsageError: the dataset does not know a value, or a value is invalid.
            DatasetError: the split does not exist.

        Example:
            >>> dataset = mirror.open("dataset")
            >>> dataset.where(light=["dusk", "night"], camera="rear")
            Dataset('dataset': 2 traversals, 8 images)
            >>> len(dataset.where(split="novel", role="train").traversals())
            2
        """
        added = Filters(
            scene=self._known("scene", scene, self._values("scenes", "scene_id")),
            traversal=self._known("traversal", traversal, self._values("traversals", "traversal_id")),
            drive=self._known("drive", drive, self._values("passes", "drive_id")),
            camera=self._known("camera", camera, self._values("traversals", "cameras")),
            vehicle=self._known("vehicle", vehicle, self._values("traversals", "vehicle_id")),
            light=self._known("light", light, chain([_LIGHT], self._values("traversals", "light"))),
            weather=self._known("weather", weather, chain([_WEATHER], self._values("traversals", "weather"))),
            time=parse_interval(time),
            within=() if within is None else (self._circle(within),),
            withheld=None if withheld is None else frozenset([bool(withheld)]),
        )
        if split is not None:
            added = added.combined_with(Filters(traversal=self._in_split(split, role)))
        elif role is not None:
            raise UsageError("role without split", place="role", remedy="give split=NAME too")
        return replace(self, filters=self.filters.combined_with(added))

    def with_layers(
        self,
        *,
        poses: str | None = None,
        calibrations: str | None = None,
        stage: str | None = None,
        boxes: str | None = None,
        depth: str | None = None,
        points: str | None = None,
    ) -> Dataset:
        """Make a view that reads other layers; layers that are not named stay unchanged.

        Args:
            poses: ``recorded`` or ``source@version``.
            calibrations: ``recorded`` or ``source@version``.
            stage: ``factory``, ``online`` or ``refined``.
            boxes: ``source@version``.
            depth: ``source@version``.
            points: ``source@version``.

        Raises:
            UsageError: no traversal of the dataset has the layer, or the stage does not exist.

        Example:
            >>> view = mirror.open("dataset").with_layers(boxes="petr@1", stage="factory")
            >>> view.layers.boxes
            'petr@1'
        """
        changes: dict[str, str] = {}
        layers = {layer for names in self._all("traversals", "layers") for layer in names}
        recorded = {"poses": poses, "calibrations": calibrations}
        for kind, name in {**recorded, "boxes": boxes, "depth": depth, "points": points}.items():
            if name is None:
                continue
            known = {layer.partition("/")[2] for layer in layers if layer.startswith(f"{kind}/")}
            require_known(f"{kind} layer", name, known | {"recorded"} if kind in recorded else known)
            changes[kind] = name
        if stage is not None:
            require_known("stage", stage, {"factory", "online", "refined"})
            changes["stage"] = stage
        return replace(self, layers=replace(self.layers, **changes))

    def table(self, name: str, columns: Iterable[str] | None = None) -> pa.Table:
        """Read the rows of an index table that are in the view.

        Args:
            name: ``scenes``, ``traversals``, ``passes``, ``frames``, ``images``, ``ego_poses``, ``calibrations``,
                ``boxes``, ``masks``, ``depth``, ``points`` or ``row_groups``.
            columns: the columns to read, in this order; None: all.

        Raises:
            UsageError: the table or a column does not exist.

        Example:
            >>> dataset = mirror.open("dataset")
            >>> rows = dataset.table("traversals", ["drive_id", "light", "images"])
            >>> rows.to_pylist()[0]
            {'drive_id': 'd0', 'light': 'day', 'images': 8}
        """
        require_known("table", name, TABLES)
        known = TABLES[name].schema.names
        chosen = list(known if columns is None else columns)
        for column in chosen:
            require_known(f"column of {name}", column, known)
        return read_rows(self._catalog, self.filters, name, chosen)

    def to_pandas(self, name: str, columns: Iterable[str] | None = None) -> pd.DataFrame:
        """Read the rows of an index table as a data frame; see `table`."""
        return self.table(name, columns).to_pandas()

    def count(self, name: str) -> int:
        """Count the rows of an index table in the view. Row groups that pass as a whole are not read.

        Raises:
            UsageError: the table does not exist.

        Example:
            >>> mirror.open("dataset").count("boxes")
            6
        """
        require_known("table", name, TABLES)
        return count_rows(self._catalog, self.filters, name)

    def sql(self, query: str) -> pa.Table:
        """Run an SQL query over the index tables with DuckDB; the views are named after the tables.

        In a view with filters, each table has the rows of the view. A query reads nothing but these tables and writes
        nothing.

        Args:
            query: one SELECT statement. Geometry is WKB; the functions of DuckDB's extension ``spatial`` are there if
                it is installed.

        Raises:
            UsageError: DuckDB is not installed, the query is not a SELECT statement, or it is invalid.

        Example:
            >>> dataset = mirror.open("dataset")
            >>> dataset.sql("SELECT light, count(*) AS n FROM traversals GROUP BY light ORDER BY light").to_pylist()
            [{'light': 'day', 'n': 1}, {'light': 'dusk', 'n': 1}, {'light': 'night', 'n': 1}]
        """
        from mirror.dataset.sql import run_sql

        return run_sql(self, query)

    def points(self) -> Points:
        """Read the points of the chosen layer, of all traversals in the view that have it.

        A reconstruction of a scene starts from the points of its training traversals.

        Raises:
            UsageError: a traversal has several point layers and none was chosen.
            DatasetError: no traversal has the chosen layer.
        """
        from mirror.dataset.points import read_points

        return read_points(self._catalog, self.filters, self.layers.points)

    def frames(self) -> FrameSequence:
        """Return the frames in the view: synchronised images of all its cameras, in order of traversal and time.

        Example:
            >>> frames = mirror.open("dataset").frames()
            >>> len(frames), frames[0].scene_id, list(frames[0].images)
            (12, 'a', ['front_wide', 'rear'])
        """
        from mirror.dataset.frames import FrameSequence

        return FrameSequence.from_view(self._catalog, self.filters, self.layers)

    def road_map(self, scene: str | None = None) -> RoadMap | None:
        """Read the recorded road map of a scene, which `mirror ingest --map` added; None without a recorded map.

        Args:
            scene: id of a scene in the view; None: the view has only one.

        Raises:
            UsageError: the view has no such scene, or several and none is named, or the map is of another scene.
            DatasetError: the map's file is missing or was changed.
            SchemaError: the file is not a road map, or a feature is invalid.

        Example:
            >>> mirror.open("dataset").road_map("a") is None
            True
        """
        from mirror.dataset.recorded_map import read_recorded_map

        scenes = self.scenes()
        if scene is None and len(scenes) != 1:
            raise UsageError(
                f"the view has {len(scenes)} scenes", place="scene", expected=f"one of {', '.join(scenes)}"
            )
        chosen = scenes[0] if scene is None else scene
        require_known("scene", chosen, scenes)
        (row,) = self.where(scene=chosen).table("scenes", [*Roi.model_fields]).to_pylist()
        return read_recorded_map(self.store, Roi.model_validate(row))

    def _column(self, table: str, column: str) -> list[Any]:
        return self.table(table, [column]).column(0).to_pylist()

    def _all(self, table: str, column: str) -> set[Any]:
        values = self._catalog.read_global(table, [column]).column(0)
        if pa.types.is_list(values.type):
            return {tuple(value) for value in values.to_pylist()}
        return set(pc.unique(values).to_pylist())

    def _values(self, table: str, column: str) -> Iterator[Iterable[str]]:
        """Yield the values of a column of a global table, segment by segment."""
        for values in self._catalog.read_by_segment(table, column):
            flat = pc.list_flatten(values) if pa.types.is_list(values.type) else values
            yield pc.unique(flat).to_pylist()

    def _known(self, what: str, choice: Choice, known: Iterable[Iterable[str]]) -> frozenset[str] | None:
        if choice is None:
            return None
        chosen = frozenset([choice] if isinstance(choice, str) else choice)
        seen: set[str] = set()
        for values in known:
            seen.update(values)
            if chosen <= seen:
                return chosen
        for value in sorted(chosen - seen, key=str):
            require_known(what, value, seen)
        return chosen

    def _circle(self, within: Within) -> Circle | LocalCircle:
        if len(within) == 3:
            lon, lat, radius = within
            return Circle(float(lon), float(lat), float(radius))
        if len(within) == 4:
            x, y, radius, frame = within
            require_known("frame", frame, {value for value in self._all("scenes", "frame") if value is not None})
            return LocalCircle(frame, float(x), float(y), float(radius))
        raise UsageError(
            f"{within!r}", place="within", expected="(longitude, latitude, radius_m) or (x_m, y_m, radius_m, frame)"
        )

    def _assignments(self, split: str) -> dict[str, str]:
        """Roles of a split's traversals by traversal id, without the unused ones."""
        return {key: role for key, role in read_split(self.store, split).assignments.items() if role != "unused"}

    def _in_split(self, split: str, role: Choice) -> frozenset[str]:
        assignments = self._assignments(split)
        assigned = sorted(set(assignments.values()))
        roles = self._known("role", role, [[value for value in get_args(Role) if value != "unused"]])
        if roles is not None and roles.isdisjoint(assigned):
            raise UsageError(
                f"no traversal has the role {' or '.join(map(repr, sorted(roles)))} in split {split!r}",
                place="role",
                expected=f"one of {', '.join(assigned)}" if assigned else "nothing: the split has no traversals",
            )
        return frozenset(key for key, value in assignments.items() if roles is None or value in roles)


def open(path: str | os.PathLike[str], *, at: int | None = None) -> Dataset:
    """Open a dataset for reading, as of the newest snapshot of its index.

    Files that were added since that snapshot are not seen: `mirror check` finds them, `mirror index` adds them.

    Args:
        path: its folder, or a URL that fsspec reads.
        at: number of an earlier snapshot.

    Raises:
        DatasetError: the folder has no dataset or no index, there is no such snapshot, or its files have been replaced.
        SchemaError: a document is broken, or its schema version is one that this toolkit does not read.

    Example:
        >>> dataset = mirror.open("dataset")
        >>> dataset
        Dataset('dataset': 3 traversals, 24 images)
        >>> dataset.cameras()
        ['front_wide', 'rear']
        >>> mirror.open("dataset", at=dataset.snapshot).count("images")
        24
    """
    store = Store(path)
    document = read_document(store)
    held, number, snapshot, sha256 = open_snapshot(store, at)
    return Dataset(document, Filters(), LayerChoice(), number, sha256, Catalog(held, snapshot))


def _reopen(root: str, number: int, index_sha256: str, filters: Filters, layers: LayerChoice) -> Dataset:
    store = Store(root) if Store(root).folder is None else store_at(root, number)
    snapshot = read_snapshot(store, number)
    if hash_snapshot(snapshot) != index_sha256:
        raise DatasetError(
            "the index has changed since this view was made",
            file=store.full_path("index"),
            remedy="open the dataset again and make the view again",
        )
    return Dataset(read_document(store), filters, layers, number, index_sha256, Catalog(store, snapshot))
