"""Measures the ROI trigger, copying, memory and start-up of ingest, against simpler methods."""
