"""Where nodes get more Gaussians, and where they lose some: by how much pictures pull at them."""
