"""Training of the autoencoder and of the generator, resumable bit for bit."""
