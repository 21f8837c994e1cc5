"""A cache of items that are made when they are needed; the latest ones are kept, up to a total size."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

Key = TypeVar("Key")
Item = TypeVar("Item")


class KeptItems(Generic[Key, Item]):
    """A cache of items by key, which drops the least recently used item first; threads may share it.

    Two threads that ask for one absent item at the same time both make it, and one of them is kept.

    Args:
        most: total size that is kept, in any unit, such as bytes; the item in use is kept in any case.

    Attributes:
        held: size of the items that it holds.
        made: number of items that were made, those made again included.
    """

    def __init__(self, most: int) -> None:
        self._most, self.held, self.made = most, 0, 0
        self._items: OrderedDict[Key, tuple[Item, int]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Key, make: Callable[[], Item], measure: Callable[[Item], int]) -> Item:
        """Return the item of a key; make it if the cache does not hold it.

        Args:
            key: the item.
            make: makes it.
            measure: returns its size.
        """
        with self._lock:
            if key in self._items:
                self._items.move_to_end(key)
                return self._items[key][0]
        item = make()
        size = measure(item)
        with self._lock:
            self.made += 1
            if key in self._items:
                return self._items[key][0]
            self._items[key] = item, size
            self.held += size
            while self.held > self._most and len(self._items) > 1:
                _, (_, gone) = self._items.popitem(last=False)
                self.held -= gone
        return item
