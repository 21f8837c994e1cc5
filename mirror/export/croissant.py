"""``croissant.json`` of a published dataset: MLCommons Croissant 1.0, which dataset hosts and search engines read."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Final

import pyarrow as pa

from mirror.counting import count_of
from mirror.dataset.dataset import Dataset
from mirror.dataset.statistics import compute_statistics
from mirror.errors import UsageError
from mirror.schema.bundle import Bundle
from mirror.schema.index_tables import INDEX_BY_SCENE, INDEX_GLOBAL, ROW_GROUPS
from mirror.schema.tables import Table

_CONTEXT: Final = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileProperty": "cr:fileProperty",
    "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
"""The context that the specification prescribes."""

_PARQUET: Final = "application/x-parquet"
_MEDIA: Final = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png", ".mp4": "video/mp4"}
_IMAGES: Final = frozenset({"image/jpeg", "image/png"})
_OTHER_MEDIA: Final = "application/octet-stream"
_UNIQUE: Final = frozenset({"scenes", "traversals", "frames", "images"})
"""Tables whose order is that of a key."""
_KEYWORDS: Final = (
    "autonomous driving", "multi-traversal", "novel view synthesis", "multi-camera", "3D reconstruction",
)  # fmt: skip
_PAPER: Final = (
    "@inproceedings{li2026hybridworldsim, title={{HybridWorldSim}: A Scalable and Controllable High-fidelity "
    "Simulator for Autonomous Driving}, author={Li, Qiang and Jiang, Yingwenqi and Li, Tuoxi and Chen, Duyu and Feng, "
    "Xiang and Ao, Yucheng and others}, booktitle={Proceedings of the 34th ACM International Conference on "
    "Multimedia}, year={2026}, doi={10.1145/3767308.3835950}}"
)


@dataclass(frozen=True)
class Publication:
    """The facts for Croissant that only the publisher of a dataset knows.

    Attributes:
        url: page of the dataset.
        creator: who made the dataset.
        date: ISO date of the publication.
        citation: how the dataset is cited; None: by its name, and by the paper of the benchmark.
    """

    url: str | None = None
    creator: str | None = None
    date: str | None = None
    citation: str | None = None

    def missing(self) -> list[str]:
        """List the options of `mirror dataset publish` that Croissant requires and that were not given."""
        given = {"--url": self.url, "--creator": self.creator, "--date": self.date}
        return [option for option, value in given.items() if value is None]


def write_croissant(
    dataset: Dataset, bundle: Bundle, images: Iterable[str], *, name: str, publication: Publication
) -> str:
    """Write the text of ``croissant.json``.

    The tables of the index are files with their SHA-256 and sets of records, one field a column; columns of bytes and
    of structures are left out. Images are sets of files by pattern; withheld images are not among the files.

    Args:
        dataset: the complete dataset.
        bundle: the published part, with its files.
        images: paths of the published images, or of the videos that hold them.
        name: title of the dataset.
        publication: what only the publisher knows.

    Raises:
        UsageError: a published image lies outside the traversals.
    """
    patterns = _patterns(images)
    document: dict[str, Any] = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": name,
        "description": _description(dataset, bundle),
        "license": bundle.licence,
        "citeAs": publication.citation or f"{name}, data of hash {bundle.dataset_hash}. {_PAPER}",
        "keywords": list(_KEYWORDS),
        "isLiveDataset": False,
        "version": f"1.0.0+{bundle.dataset_hash[:12]}",
        "distribution": [*_table_files(bundle), *_image_files(patterns)],
        "recordSet": [*_records(bundle), *_image_records(patterns)],
    }
    if publication.url is not None:
        document["url"] = publication.url
    if publication.creator is not None:
        document["creator"] = {"@type": "sc:Organization", "name": publication.creator}
    if publication.date is not None:
        document["datePublished"] = publication.date
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _description(dataset: Dataset, bundle: Bundle) -> str:
    totals = compute_statistics(dataset)
    return (
        f"{count_of(totals.traversals, 'traversal')} of {count_of(len(totals.scenes), 'scene')} by "
        f"{count_of(totals.vehicles, 'vehicle')} with several cameras: images, poses, calibrations and boxes of the "
        "same streets in different light and weather. "
        f"{count_of(len(bundle.withheld), 'image')} that benchmarks are scored against (split {bundle.split}) are "
        "withheld: their rows in the table of images have no file. Poses map points of src into dst (dst_SE3_src); "
        "times are Unix nanoseconds; units stand in the names of columns."
    )


def _patterns(images: Iterable[str]) -> dict[str, list[str]]:
    """Patterns of the paths of published images, by media type."""
    found: dict[str, set[str]] = {}
    for name in images:
        path = PurePosixPath(name)
        parts = path.parts
        fixed = 3 if len(parts) > 3 and parts[2] == "recorded" else 4
        if parts[0] != "traversals" or len(parts) <= fixed:
            raise UsageError(
                "a published image lies outside the traversals", file=name,
                expected="traversals/<id>/recorded/ or traversals/<id>/layers/<kind>/",
                remedy="`mirror check` lists what does not fit the layout",
            )  # fmt: skip
        folders = ["*"] * (len(parts) - fixed - 1)
        pattern = "/".join(["traversals", "*", *parts[2:fixed], *folders, f"*{path.suffix}"])
        found.setdefault(_MEDIA.get(path.suffix.lower(), _OTHER_MEDIA), set()).add(pattern)
    return {media: sorted(found[media]) for media in sorted(found)}


def _image_files(patterns: Mapping[str, Sequence[str]]) -> list[dict[str, Any]]:
    return [
        {
            "@type": "cr:FileSet",
            "@id": f"files/{media}",
            "name": f"files/{media}",
            "description": "Files of the published images.",
            "encodingFormat": media,
            "includes": list(includes),
        }
        for media, includes in patterns.items()
    ]


def _image_records(patterns: Mapping[str, Sequence[str]]) -> list[dict[str, Any]]:
    """Sets of records with the path and the pixels of each published image."""
    sets = []
    for media in sorted(_IMAGES & patterns.keys()):
        own, source = f"pixels-{PurePosixPath(media).name}", {"@id": f"files/{media}"}
        path = {"fileSet": source, "extract": {"fileProperty": "fullpath"}}
        content = {"fileSet": source, "extract": {"fileProperty": "content"}}
        about = "Path in the bundle: `uri` of the table of images."
        sets.append(
            {
                "@type": "cr:RecordSet",
                "@id": own,
                "name": own,
                "description": "One published image.",
                "key": {"@id": f"{own}/path"},
                "field": [
                    _field(own, "path", "sc:Text", about, path),
                    _field(own, "content", "sc:ImageObject", "The image.", content),
                ],
            }
        )
    return sets


def _table_files(bundle: Bundle) -> list[dict[str, Any]]:
    """One file for each table of the index, and one set of files for each table that has a file a scene."""
    files: list[dict[str, Any]] = []
    for table, names in _tables(bundle):
        files += [
            {
                "@type": "cr:FileObject",
                "@id": name,
                "name": name,
                "contentUrl": name,
                "contentSize": f"{bundle.files[name].bytes} B",
                "encodingFormat": _PARQUET,
                "sha256": bundle.files[name].sha256,
            }
            for name in names
        ]
        if table in INDEX_BY_SCENE:
            files.append(
                {
                    "@type": "cr:FileSet",
                    "@id": f"tables/{table.name}",
                    "name": f"tables/{table.name}",
                    "description": f"The table of {table.name}: one file a scene.",
                    "encodingFormat": _PARQUET,
                    "includes": table.place.replace("<segment>", "*").replace("<scene_id>", "*"),
                }
            )
    return files


def _records(bundle: Bundle) -> list[dict[str, Any]]:
    sets = []
    for table, names in _tables(bundle):
        by_scene = table in INDEX_BY_SCENE
        source = {"fileSet": {"@id": f"tables/{table.name}"}} if by_scene else {"fileObject": {"@id": names[0]}}
        fields = [field for column in table.schema if (field := _column(table.name, column, source)) is not None]
        records = {
            "@type": "cr:RecordSet",
            "@id": table.name,
            "name": table.name,
            "description": f"{table.row[0].upper()}{table.row[1:]}.",
            "field": fields,
        }
        if table.name in _UNIQUE:
            records["key"] = [{"@id": f"{table.name}/{column}"} for column in table.sorted_by]
        sets.append(records)
    return sets


def _tables(bundle: Bundle) -> list[tuple[Table, list[str]]]:
    """The tables of the index that the bundle has, with their files."""
    found = []
    for table in (*INDEX_GLOBAL, *INDEX_BY_SCENE):
        pattern = table.place.replace("<segment>", "*").replace("<scene_id>", "*")
        names = [name for name in bundle.files if PurePosixPath(name).match(pattern)]
        if names and table is not ROW_GROUPS:
            found.append((table, names))
    return found


def _column(table: str, column: pa.Field, source: Mapping[str, Any]) -> dict[str, Any] | None:
    """One column as a field; None: it has bytes or structures."""
    kind = column.type
    is_list = pa.types.is_list(kind)
    data_type = _data_type(kind.value_type if is_list or pa.types.is_dictionary(kind) else kind)
    if data_type is None:
        return None
    extract = {**source, "extract": {"column": column.name}}
    field = _field(table, column.name, data_type, column.metadata[b"doc"].decode(), extract)
    return {**field, "repeated": True} if is_list else field


def _data_type(kind: pa.DataType) -> str | None:
    if pa.types.is_string(kind):
        return "sc:Text"
    if pa.types.is_boolean(kind):
        return "sc:Boolean"
    if pa.types.is_integer(kind):
        return "sc:Integer"
    return "sc:Float" if pa.types.is_floating(kind) else None


def _field(owner: str, name: str, data_type: str, about: str, source: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "@type": "cr:Field",
        "@id": f"{owner}/{name}",
        "name": f"{owner}/{name}",
        "description": about,
        "dataType": data_type,
        "source": source,
    }
