"""Where training adds and removes Gaussians."""
