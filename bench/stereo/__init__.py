"""What stereo networks share: padding, resizing, tiling, left-right check, device, checkpoints."""
