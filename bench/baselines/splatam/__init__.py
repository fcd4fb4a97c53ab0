"""SplaTAM (Keetha et al., CVPR 2024): what its tracker and its mapper are made of."""
