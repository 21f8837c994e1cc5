"""Images that are rendered when somebody reads them, by a uri that says which: no file holds them."""

from __future__ import annotations
