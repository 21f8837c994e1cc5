"""Where the weights of networks come from: found, verified by hash, loaded without running what is in them."""
