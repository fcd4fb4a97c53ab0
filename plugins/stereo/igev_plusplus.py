"""IGEV++ (Xu et al., PAMI 2025), MIT licence, from the authors' checkout."""

from __future__ import annotations

from bench.registry import register
from bench.stereo.upstream.network import UpstreamConfig, UpstreamNetwork
from bench.stereo.upstream.recipe import UpstreamRecipe


@register("stereo", "igev_plusplus", config=UpstreamConfig)
class IgevPlusPlus(UpstreamNetwork):
    """IGEV++, KITTI 2015; the authors' code and weights (stereo.checkout, stereo.weights) or an ONNX file."""

    recipe = UpstreamRecipe(
        title="IGEV++",
        repository="https://github.com/gangweiX/IGEV-plusplus",
        tested_commit="8add77f8dd30549f58fcc76e7aa6028b727cdc1d",
        weights="igev_plusplus_kitti2015",
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
            "max_disp": 768,
            "s_disp_range": 48,
            "m_disp_range": 96,
            "l_disp_range": 192,
            "s_disp_interval": 1,
            "m_disp_interval": 2,
            "l_disp_interval": 4,
        },
        iterations=32,
        patches=("torchvision", "timm"),
    )
