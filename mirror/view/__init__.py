"""Views of a dataset: the HTML report with its map and charts, plots, and videos."""
