"""AnyNet (Wang et al., ICRA 2019): the smallest of the networks, for CPUs."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from bench.errors import require_choice
from bench.registry import register
from bench.stereo.checkpoint import fit_state, load_state
from bench.stereo.network import NetworkConfig
from bench.stereo.torch_network import TorchStereo
from bench.weights import missing


@dataclass(frozen=True)
class AnyNetConfig(NetworkConfig):
    """Settings of every network, and the published checkpoint."""

    trained_on: str = "kitti2015"
    """Published checkpoint to use where weights is empty: kitti2015 or kitti2012."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_choice("stereo.trained_on", self.trained_on, ("kitti2015", "kitti2012"))


@register("stereo", "anynet", config=AnyNetConfig)
class AnyNetStereo(TorchStereo):
    """AnyNet's three stages with the authors' KITTI weights: coarse, but the fastest network on a CPU."""

    pad_multiple = 16

    def __init__(self, config: AnyNetConfig) -> None:
        super().__init__(config, published=f"anynet_{config.trained_on}")

    @staticmethod
    def missing_weights() -> str | None:
        """How to get the published checkpoint, or None."""
        return missing("anynet_kitti2015")

    def load(self) -> torch.nn.Module:
        """The network with the checkpoint's weights; raises ``BenchError`` if they don't fit."""
        from bench.stereo.networks.anynet import AnyNet, FastAnyNet  # here: it imports torch

        assert self.weights_path is not None
        network = AnyNet()
        fit_state(network, load_state(self.weights_path), self.weights_path, ignore=("refine_spn.",))
        return FastAnyNet(network)
