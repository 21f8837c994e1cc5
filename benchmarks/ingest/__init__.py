"""The ROI trigger, copying and linking, and start-up: time, exactness, and what a plainer way would take."""
