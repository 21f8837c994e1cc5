"""All readers, one module or package of a format's name each, and what they share: boxes, poses, tables."""
