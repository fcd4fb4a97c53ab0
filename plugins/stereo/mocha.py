"""MoCha-Stereo (Chen et al., CVPR 2024), MIT licence, from the authors' checkout."""

from __future__ import annotations

from bench.registry import register
from bench.stereo.upstream.network import UpstreamConfig, UpstreamNetwork
from bench.stereo.upstream.recipe import UpstreamRecipe


@register("stereo", "mocha", config=UpstreamConfig)
class Mocha(UpstreamNetwork):
    """MoCha-Stereo, SceneFlow (no KITTI weights are published); authors' checkout and weights, or an ONNX file."""

    recipe = UpstreamRecipe(
        title="MoCha-Stereo",
        repository="https://github.com/ZYangChen/MoCha-Stereo",
        tested_commit="78c5889c467fe31414c9425f1280afc0a8f6c1a0",
        weights="mocha_sceneflow",
        roots=("MoCha-Stereo",),
        module="core.mocha_stereo",
        class_name="Mocha",
        arguments={
            "mixed_precision": False,
            "hidden_dims": [128, 128, 128],
            "corr_implementation": "reg",
            "shared_backbone": False,
            "corr_levels": 2,
            "corr_radius": 4,
            "n_downsample": 2,
            "slow_fast_gru": False,
            "n_gru_layers": 3,
            "max_disp": 192,
        },
        iterations=32,
        patches=("torchvision", "timm"),
    )
