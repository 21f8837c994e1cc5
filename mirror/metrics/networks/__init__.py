"""The networks behind perceptual metrics, in plain torch: torchvision does not import beside every torch build."""
