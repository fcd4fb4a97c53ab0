"""The random scenes that `bgs-bench check-plugin` compares rasterizers with, for the tests in this folder."""

from bench.authoring.random_scenes import (
    GROUPS,
    SceneSpec,
    image_gradients,
    random_scene,
    random_view,
    relative_l2,
    render_and_back,
)

__all__ = ["GROUPS", "SceneSpec", "image_gradients", "random_scene", "random_view", "relative_l2", "render_and_back"]
