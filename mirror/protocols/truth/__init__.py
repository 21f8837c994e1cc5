"""The truth that submissions are compared with: recorded or hidden images in the final raster, and scored masks."""
