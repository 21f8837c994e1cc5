"""What is compiled for the CPU, in plain torch: it runs on any device, and is the reference of the kernels' tests."""
