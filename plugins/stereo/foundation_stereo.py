"""FoundationStereo (Wen et al., CVPR 2025), licence for non-commercial research, from the authors' checkout."""

from __future__ import annotations

from bench.registry import register
from bench.stereo.upstream.network import UpstreamConfig, UpstreamNetwork
from bench.stereo.upstream.recipe import UpstreamRecipe


@register("stereo", "foundation_stereo", config=UpstreamConfig)
class FoundationStereo(UpstreamNetwork):
    """FoundationStereo, ViT-L; the authors' checkout and weights with cfg.yaml beside them, or an ONNX file."""

    recipe = UpstreamRecipe(
        title="FoundationStereo",
        repository="https://github.com/NVlabs/FoundationStereo",
        tested_commit="6e8806816b533e4d13ddbb95ffa907b797060a62",
        weights="foundation_stereo_vitl",
        module="core.foundation_stereo",
        class_name="FoundationStereo",
        # All others stand in cfg.yaml; the large network's has no vit_size.
        arguments={"vit_size": "vitl", "low_memory": 0},
        arguments_file="cfg.yaml",
        iterations=32,
        patches=("torchvision", "timm", "dinov2"),
        stand_ins=("open3d", "trimesh", "joblib", "imageio", "transformations"),
        environment={"XFORMERS_DISABLED": "1"},
    )
