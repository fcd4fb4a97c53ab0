"""The contract of a keyframer: the first frame is a keyframe, and the window holds keyframes, oldest first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from bench.authoring import probes
from bench.authoring.shown_map import ShownMap
from bench.authoring.verdict import Candidate, Check, ContractBrokenError, Note
from bench.types import KeyframeDecision, StereoFrame, TrackingResult

_FRAMES = 8
_LANDMARKS = 300


@dataclass
class Subject:
    """The keyframer under test and the tracked frames it is tested with."""

    candidate: Candidate

    @cached_property
    def dataset(self) -> Any:
        return self.candidate.other("dataset")

    @cached_property
    def tracked(self) -> list[tuple[StereoFrame, TrackingResult]]:
        """Frames with true poses and landmarks of which a third is new in each frame."""
        dataset = self.dataset
        probes.require_frames(dataset, 4)
        truth, found = dataset.ground_truth(), []
        for position in range(min(_FRAMES, len(dataset))):
            T = np.eye(4) if truth is None or len(truth) < len(dataset) else truth.T_world_cam[position]
            seen = np.arange(_LANDMARKS, dtype=np.int64) + position * _LANDMARKS // 3
            found.append((dataset.frame(position), TrackingResult(T, "ok", _LANDMARKS, 0.5, seen)))
        return found

    def started(self) -> tuple[Any, ShownMap | None]:
        """A fresh instance, and the map that it looks at; None where it does not."""
        keyframer = self.candidate.build()
        keyframer.start(self.dataset.camera)
        if not keyframer.uses_map:
            return keyframer, None
        shown = ShownMap(self.candidate, self.dataset)
        keyframer.use_map(shown.mapper.view())
        return keyframer, shown

    def decide(
        self, tracked: list[tuple[StereoFrame, TrackingResult]], break_after: int | None = None
    ) -> list[KeyframeDecision]:
        """The decisions of a fresh instance, each of them checked; a map that it looks at learns its keyframes.

        With ``break_after`` another instance goes on after so many frames, from what a checkpoint would hold.
        """
        keyframer, shown = self.started()
        truth = self.dataset.ground_truth()
        decisions: list[KeyframeDecision] = []
        admitted: list[int] = []
        for frame, tracking in tracked:
            decision = keyframer.update(frame, tracking)
            _require_decision(decision, frame.number, admitted)
            decisions.append(decision)
            if shown is not None and decision.is_keyframe and tracking.T_world_cam is not None and truth is not None:
                shown.learn(frame, tracking.T_world_cam, list(decision.window), truth)
            if len(decisions) == break_after:
                state = probes.through_a_file(keyframer.state())
                keyframer = self.candidate.build()
                keyframer.start(self.dataset.camera)
                if shown is not None:
                    keyframer.use_map(shown.mapper.view())
                keyframer.restore(state)
        return decisions


def _require_decision(decision: Any, number: int, admitted: list[int]) -> None:
    """Raise ``ContractBrokenError`` for what is no decision; ``admitted`` are the keyframes so far, and grows."""
    if not isinstance(decision, KeyframeDecision):
        raise ContractBrokenError(
            f"update() of frame {number} returned {type(decision).__name__}",
            "bench.types.KeyframeDecision",
            "return KeyframeDecision(is_keyframe, reason, window)",
            "update",
        )
    if not admitted and not decision.is_keyframe:
        raise ContractBrokenError(
            "the first tracked frame is no keyframe",
            "a keyframe: the map begins with it",
            "make the first frame a keyframe whatever the rule says",
            "update",
        )
    if decision.is_keyframe:
        admitted.append(number)
    window = list(decision.window)
    wrong = ""
    if decision.is_keyframe and (not window or window[-1] != number):
        wrong = f"does not end with the new keyframe {number}"
    elif any(b <= a for a, b in pairwise(window)):
        wrong = "is not in order, oldest first, each once"
    elif not set(window) <= set(admitted):
        wrong = f"holds {sorted(set(window) - set(admitted))}, which never became keyframes"
    if wrong:
        raise ContractBrokenError(
            f"the window {window} after frame {number} {wrong}",
            "frame numbers (frame.number) of active keyframes, oldest first, the new one last",
            "append frame.number when the frame becomes a keyframe, and drop from the front",
            "update",
        )


def _decisions(subject: Subject) -> str:
    decisions = subject.decide(subject.tracked)
    found = [
        frame.number for (frame, _), decision in zip(subject.tracked, decisions, strict=True) if decision.is_keyframe
    ]
    longest = max(len(decision.window) for decision in decisions)
    return f"keyframes {', '.join(map(str, found))} of {len(decisions)} frames; at most {longest} in the window"


def _reasons(subject: Subject) -> str | Note:
    reasons = [decision.reason for decision in subject.decide(subject.tracked)]
    if not all(isinstance(reason, str) and reason for reason in reasons):
        return Note("some decisions have no reason: frames.csv will not tell why a frame became a keyframe")
    return f'"{reasons[-1]}"'


def _other_trackers(subject: Subject) -> str:
    """Trackers without features, frames that are missing (lost or held out), nothing in common with the last frame."""
    changes: dict[str, Callable[[list[Any]], list[Any]]] = {
        "no landmarks": lambda tracked: [(f, TrackingResult(t.T_world_cam, "ok")) for f, t in tracked],
        "frames missing": lambda tracked: tracked[::3],
        "weak, no landmark seen": lambda tracked: [
            (f, TrackingResult(t.T_world_cam, "weak", 0, landmarks=np.zeros(0, np.int64))) for f, t in tracked
        ],
    }
    for change in changes.values():
        subject.decide(change(subject.tracked))
    return ", ".join(changes)


def _repeats(subject: Subject) -> str:
    first, second = subject.decide(subject.tracked), probes.in_thread(lambda: subject.decide(subject.tracked))
    if first != second:
        raise ContractBrokenError(
            "a fresh instance in a background thread decided otherwise",
            "the same decisions",
            "keep no state in the class or the module, and no randomness but from a seed",
            "update",
        )
    return "a fresh instance in a background thread: the same decisions"


def _resumes(subject: Subject) -> str | Note:
    keyframer, shown = subject.started()
    if keyframer.state() is None:
        if shown is None:
            return "it gives no state(): its frames are decided again after a kill"
        return Note("it looks at the map and gives no state(): runs with it have no checkpoints")
    half = len(subject.tracked) // 2
    if subject.decide(subject.tracked) != subject.decide(subject.tracked, break_after=half):
        raise ContractBrokenError(
            f"a fresh instance that goes on from state() after {half} frames decided otherwise",
            "the same decisions as without a break",
            "put all that deciding depends on into state(), and take it over in restore()",
            "restore",
        )
    return f"a fresh instance goes on from state() after {half} frames: the same decisions"


def _inputs(subject: Subject) -> str:
    frame, tracking = subject.tracked[0]
    left, landmarks = frame.left.copy(), np.array(tracking.landmarks)
    T = np.array(tracking.T_world_cam)
    keyframer, _ = subject.started()
    keyframer.update(
        StereoFrame(frame.number, frame.timestamp, left, frame.right),
        TrackingResult(T, "ok", _LANDMARKS, 0.5, landmarks),
    )
    probes.require_untouched("the input left", frame.left, left, "update")
    probes.require_untouched("the input T_world_cam", tracking.T_world_cam, T, "update")
    probes.require_untouched("the input landmarks", tracking.landmarks, landmarks, "update")
    return "left as they were"


def checks_of(subject: Subject) -> tuple[Check[Subject], ...]:
    """All checks of a keyframer."""
    return (
        Check("decisions", _decisions, essential=True),
        Check("reasons", _reasons),
        Check("other trackers", _other_trackers),
        Check("determinism", _repeats),
        Check("resumes", _resumes),
        Check("inputs", _inputs),
    )
