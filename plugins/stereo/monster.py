"""MonSter (Cheng et al., CVPR 2025), licence for non-commercial research and education, from the authors' checkout.

One network with two sets of weights: MonSter-K, trained on KITTI, and MonSter-M, trained on a mixture of data sets,
which is the paper's choice.
"""

from __future__ import annotations

from dataclasses import replace

from bench.registry import register
from bench.stereo.upstream.network import UpstreamConfig, UpstreamNetwork
from bench.stereo.upstream.recipe import UpstreamRecipe

_MONSTER_K = UpstreamRecipe(
    title="MonSter",
    repository="https://github.com/Junda24/MonSter",
    tested_commit="49016c9a72b4260c0d119c77bb14e78a132cea8c",
    weights="monster_k",
    import_folders=("", "Depth-Anything-V2-list3"),
    module="core.monster",
    class_name="Monster",
    arguments={
        "encoder": "vitl",
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
    # The monocular branch has the last seven updates.
    least_iterations=8,
    patches=("torchvision", "depth_anything"),
)


@register("stereo", "monster_k", config=UpstreamConfig)
class MonsterK(UpstreamNetwork):
    """MonSter-K, KITTI; the authors' code and weights (stereo.checkout, stereo.weights) or an ONNX file."""

    recipe = _MONSTER_K


@register("stereo", "monster_m", config=UpstreamConfig)
class MonsterM(UpstreamNetwork):
    """MonSter-M, a mixture of data sets: the paper's default; the authors' checkout and weights, or an ONNX file."""

    recipe = replace(_MONSTER_K, weights="monster_m")
