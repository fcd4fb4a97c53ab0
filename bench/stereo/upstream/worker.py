"""The process in which one published network runs; ``bench.stereo.upstream.network`` starts it."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import torch

from bench.errors import BenchError
from bench.peers.messages import Message
from bench.peers.serve import serve_messages
from bench.stereo.upstream.model import Motion, UpstreamModel, told
from bench.stereo.upstream.recipe import UpstreamRecipe


class Worker:
    """Answers ``load`` once, then ``match`` for every pair."""

    def __init__(self) -> None:
        self._model: UpstreamModel | None = None

    def answer(self, message: Message) -> Message:
        """The answer, or "refused" with a sentence for the user."""
        try:
            return self._answer(message)
        except BenchError as error:
            return Message("refused", {"reason": str(error)})
        # Whatever the authors' code raises is for the user to read, with the place where it was raised.
        except Exception as error:
            return Message("refused", {"reason": told(error)})

    def _answer(self, message: Message) -> Message:
        fields, arrays = message.fields, message.arrays
        if message.kind == "load":
            _compute_alike()
            recipe = UpstreamRecipe.from_plain(fields["recipe"])
            places = (Path(fields["root"]), Path(fields["checkpoint"]))
            self._model = UpstreamModel(recipe, *places, fields["device"], fields["trust_pickle"])
            return Message("loaded")
        if message.kind != "match" or self._model is None:
            raise ValueError(f"'{message.kind}' is not what a worker is asked here")
        motion = None
        if "K" in arrays:
            motion = Motion(arrays["K"], fields["baseline"], arrays.get("T_now_before"))
        disparity = self._model.match(arrays["left"], arrays["right"], fields["iterations"], motion)
        return Message("disparity", {}, {"disparity": disparity.astype(np.float64)})


def _compute_alike() -> None:
    """No order of additions that differs from run to run; where torch has no such algorithm it only warns."""
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.use_deterministic_algorithms(True, warn_only=True)
    torch.manual_seed(0)


if __name__ == "__main__":
    serve_messages(Worker().answer)
