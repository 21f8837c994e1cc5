"""Images: their bytes, checked, and their pixels."""
