"""Items that are made when they are needed; the last ones are kept up to a number of bytes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Final, Generic, TypeVar

Key = TypeVar("Key")
Item = TypeVar("Item")

KEEP_BYTES: Final = 2 << 30
"""Bytes of clips that a training keeps: as many as those of the study fit, larger sets are read again."""


class KeptItems(Generic[Key, Item]):
    """A cache of items by key, which drops the least recently used item first.

    Args:
        most_bytes: bytes that are kept; the item in use is kept in any case.

    Attributes:
        made: number of items that were made, those made again included.
    """

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes, self._bytes, self.made = most_bytes, 0, 0
        self._items: OrderedDict[Key, tuple[Item, int]] = OrderedDict()

    def get(self, key: Key, make: Callable[[], Item], count_bytes: Callable[[Item], int]) -> Item:
        """Return the item of a key; make it if the cache does not hold it.

        Args:
            key: the item.
            make: makes it.
            count_bytes: returns its size.
        """
        if key in self._items:
            self._items.move_to_end(key)
            return self._items[key][0]
        item = make()
        self.made += 1
        size = count_bytes(item)
        self._items[key] = item, size
        self._bytes += size
        while self._bytes > self._most_bytes and len(self._items) > 1:
            _, (_, gone) = self._items.popitem(last=False)
            self._bytes -= gone
        return item
