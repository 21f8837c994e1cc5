"""The on-disk format: tables as pyarrow schemas, JSON documents as pydantic models, and functions to read and write."""
