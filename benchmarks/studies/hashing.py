"""The hash of a declaration."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any


def hash_document(document: Mapping[str, Any]) -> str:
    """SHA-256 of the values of a document, not of their formatting."""
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()
