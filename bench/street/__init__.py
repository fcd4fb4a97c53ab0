"""A procedural street: where the camera drives, what stands beside it, ray casting and shading, all exact."""
