"""Reading of a dataset's splits by their names."""

from __future__ import annotations

from mirror.dataset.store import Store
from mirror.errors import DatasetError, UsageError
from mirror.schema.documents import SplitDocument, is_identifier
from mirror.schema.files import parse_json


def read_split(store: Store, name: str) -> SplitDocument:
    """Read a split.

    Args:
        store: files of the dataset.
        name: name of the split.

    Raises:
        UsageError: the name is not a valid name of a split.
        DatasetError: the dataset has no split of this name.
        SchemaError: the split's document is invalid.
    """
    if not is_identifier(name):
        raise UsageError(f"{name!r} cannot be the name of a split", place="split", expected="letters, digits, _ and -")
    path = f"splits/{name}.json"
    try:
        data = store.read(path)
    except FileNotFoundError as error:
        files = [file for file in store.list_files("splits") if file.endswith(".json")]
        names = [file.removesuffix(".json") for file in files]
        raise DatasetError(
            "no such split",
            file=store.full_path(path),
            expected=f"one of {', '.join(names)}" if names else None,
            remedy=f"name one of them, or make it with `mirror split {store} {name}`"
            if names
            else f"make one with `mirror split {store} {name}`",
        ) from error
    return parse_json(data, SplitDocument, store.full_path(path))
