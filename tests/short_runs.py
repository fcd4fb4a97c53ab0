"""Settings of runs whose quality no test looks at: small images, and as few iterations as there are kinds of them."""

SMALL_STREET = ("dataset=street", "dataset.frames=2", "dataset.width=96", "dataset.height=48", "cache.enabled=false")
FEW_ITERATIONS = ("mapper.iterations=2", "mapper.final_coarse_iterations=1", "mapper.final_iterations=1")
