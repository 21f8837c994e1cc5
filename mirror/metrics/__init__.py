"""Metrics: functions of arrays or tensors, and accumulators with ``update``, ``merge`` and ``compute`` beside them.

Nothing is imported here. `mirror.metrics.images` compares renders with photographs, `mirror.metrics.features`
distributions of pictures, `mirror.metrics.boxes` regions, `mirror.metrics.detection` annotations. Every variant of a
metric has a name, and ``docs/metrics.md`` says what each reproduces.
"""
