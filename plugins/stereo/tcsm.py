"""TCSM (Zeng et al., ECCV 2024), MIT licence, from the authors' checkout."""

from __future__ import annotations

from bench.registry import register
from bench.stereo.upstream.recipe import UpstreamRecipe
from bench.stereo.upstream.temporal import TemporalConfig, TemporalUpstreamNetwork


@register("stereo", "tcsm", config=TemporalConfig)
class Tcsm(TemporalUpstreamNetwork):
    """TCSM, KITTI raw, helped by the frame before; the authors' checkout and weights, or an ONNX file (no memory)."""

    recipe = UpstreamRecipe(
        title="TCSM",
        repository="https://github.com/jiaxiZeng/Temporally-Consistent-Stereo-Matching",
        tested_commit="ad714ad676265d9ed15a8fcd77a3cb35e0e3025f",
        weights="tcsm_kitti_raw",
        module="core.tc_stereo",
        class_name="TCStereo",
        # Those of the authors' submit_kitti.sh; the defaults in their code do not fit the checkpoint.
        arguments={
            "shared_backbone": True,
            "context_norm": "none",
            "mixed_precision": False,
            "init_thres": 0.5,
            "hidden_dims": [128, 128, 128],
            "corr_levels": 4,
            "corr_radius": 4,
            "n_downsample": 2,
            "slow_fast_gru": False,
            "n_gru_layers": 3,
        },
        iterations=5,
        output="flow",
        sign=-1,
        patches=("splatting",),
    )
