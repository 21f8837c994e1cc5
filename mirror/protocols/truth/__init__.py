"""What submissions are held against: recorded or hidden pictures in the final raster, and what is scored of them."""
