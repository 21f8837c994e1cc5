"""IMG: pictures, their rows, files and pixels."""
