"""Own implementations of published stereo networks, in torch, from their papers."""
