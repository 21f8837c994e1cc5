"""Images on demand: a URI names each image, and reading it renders the image."""

from __future__ import annotations
