"""Metrics of sets of features: Fréchet and kernel distances, FID, FVD, LPIPS; and the features behind them."""
