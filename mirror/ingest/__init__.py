"""Ingest: from recordings to traversals. Cleaning, the ROI trigger, the ledger, the writer."""
