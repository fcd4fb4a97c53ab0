"""Networks as their authors published them, run from a user's own checkout and checkpoint in a process of their own.

What is tested, and what is not: the test-suite runs small stand-ins with the authors' calling conventions. By hand, the
code of all seven at the commits in their recipes, with random weights saved in the published checkpoints' layout, gave
the same numbers through the plugins as called directly on a CPU; MonSter and FoundationStereo with their smallest
backbone (ViT-S) only. The published checkpoints themselves, and CUDA, have not been tried: score a network with
`bgs-bench stereo-eval` against its published error before it is relied on.
"""
