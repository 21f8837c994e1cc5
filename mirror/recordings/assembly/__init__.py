"""Makes recordings in the `folder` layout from a track and from images or videos of cameras."""
