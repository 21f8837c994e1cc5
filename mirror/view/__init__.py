"""Looking at a dataset: the HTML report, its map and charts, plots."""
