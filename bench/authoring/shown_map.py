"""The map that a plugin under test looks at: it learns from the data set's own depth and sky."""

from __future__ import annotations

from typing import Any

from bench import registry
from bench.authoring.verdict import Candidate
from bench.types import DepthMap, Float, Keyframe, StereoFrame, Trajectory


class ShownMap:
    """A fresh mapper of the run's config on a data set."""

    def __init__(self, candidate: Candidate, dataset: Any) -> None:
        self._dataset = dataset
        self.mapper = candidate.other("mapper")
        losses = [registry.build(loss, "loss") for loss in candidate.run.several("loss")]
        self.mapper.start(dataset.camera, losses, 0)

    def learn(self, frame: StereoFrame, pose: Float, window: list[int], poses: Trajectory) -> None:
        """A keyframe at ``pose`` (4, 4), with all ``poses`` as they are now; none where its depth is not known."""
        position = self._dataset.numbers.index(frame.number)
        depth = self._dataset.true_depth(position)
        if depth is None:
            depth = self._dataset.sensor_depth(position)
        if depth is None:
            return
        self.mapper.update_poses(poses)
        sky = self._dataset.true_sky(position)
        self.mapper.add_keyframe(Keyframe(frame, DepthMap(depth, "truth"), sky, pose), window)
