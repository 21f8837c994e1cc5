"""Pictures: their bytes, checked, and their pixels."""
