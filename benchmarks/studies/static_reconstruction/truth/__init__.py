"""TrainedModel models held against what is exactly known of the synthetic street."""
