"""IGEV-Stereo (Xu et al., CVPR 2023), MIT licence, from the authors' checkout."""

from __future__ import annotations

from bench.registry import register
from bench.stereo.upstream.network import UpstreamConfig, UpstreamNetwork
from bench.stereo.upstream.recipe import UpstreamRecipe


@register("stereo", "igev", config=UpstreamConfig)
class Igev(UpstreamNetwork):
    """IGEV-Stereo, KITTI 2015; the authors' code and weights (stereo.checkout, stereo.weights) or an ONNX file."""

    recipe = UpstreamRecipe(
        title="IGEV-Stereo",
        repository="https://github.com/gangweiX/IGEV",
        tested_commit="e61a6756984844beb035ec9666ea70e05dcc6b93",
        weights="igev_kitti2015",
        roots=("IGEV-Stereo",),
        module="core.igev_stereo",
        class_name="IGEVStereo",
        arguments={
            "mixed_precision": False,
            "precision_dtype": "float32",
            "hidden_dims": [128, 128, 128],
            "corr_levels": 2,
            "corr_radius": 4,
            "n_downsample": 2,
            "n_gru_layers": 3,
            "max_disp": 192,
        },
        iterations=16,
        patches=("torchvision", "timm"),
    )
