"""PSMNet (Chang and Chen, CVPR 2018) with the KITTI 2015 checkpoint that its authors published."""

from __future__ import annotations

import torch

from bench.registry import register
from bench.stereo.checkpoint import fit_state, load_state
from bench.stereo.network import NetworkConfig
from bench.stereo.torch_network import TorchStereo
from bench.weights import missing


@register("stereo", "psmnet", config=NetworkConfig)
class PsmNetStereo(TorchStereo):
    """PSMNet with stacked hourglasses, KITTI 2015 weights: accurate; seconds per frame on a CPU, see stereo.scale."""

    pad_multiple = 32

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config, published="psmnet_kitti2015")

    @staticmethod
    def missing_weights() -> str | None:
        """How to get the published checkpoint, or None."""
        return missing("psmnet_kitti2015")

    def load(self) -> torch.nn.Module:
        """The network with the checkpoint's weights; raises ``BenchError`` if they don't fit."""
        from bench.stereo.networks.folding import fold_batch_norms  # here: they import torch
        from bench.stereo.networks.psmnet import PsmNet

        assert self.weights_path is not None
        network = PsmNet()
        fit_state(network, load_state(self.weights_path), self.weights_path)
        fold_batch_norms(network.eval())
        for parameter in network.parameters():
            if parameter.dim() in (4, 5):
                layout = torch.channels_last if parameter.dim() == 4 else torch.channels_last_3d
                parameter.data = parameter.data.contiguous(memory_format=layout)
        return network
