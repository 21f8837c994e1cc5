"""The on-disk format: tables as pyarrow schemas, JSON documents as models, and their reading and writing."""
