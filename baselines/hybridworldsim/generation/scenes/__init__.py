"""Traffic over a scene of a dataset: from recorded frames, boxes and a static model to generated frames."""
