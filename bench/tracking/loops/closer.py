"""Loop closing for a keyframe odometry: knows places again, believes loops on good evidence, corrects all poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.geometry import se3
from bench.io.torch_files import from_state, to_state
from bench.tracking.descriptors import Ints, as_they_were
from bench.tracking.growing import Archive
from bench.tracking.local_map import KeyframeRecord, View
from bench.tracking.loops.hypotheses import Match, Run, rival_of
from bench.tracking.loops.odometry_chain import OdometryChain
from bench.tracking.loops.place_list import PlaceList
from bench.tracking.loops.places import Place, PlaceIndex, WordVector, best_places, similarity, word_vector
from bench.tracking.loops.pose_graph import Edge, Graph, import_gtsam, optimise
from bench.tracking.loops.settings import LoopSettings
from bench.tracking.loops.verification import Verified, close, verify
from bench.tracking.loops.vocabulary import Vocabulary, train
from bench.types import Float, Mask, StereoCamera

_BRANCHING, _DEPTH = 10, 4
_TRAINING_SHARE = 2
"""Every second descriptor of the first places is enough for a vocabulary of its own."""
_CANDIDATES = 2
"""Groups of similar places that are looked at closely."""
_RELOCALISATION_CANDIDATES, _RELOCALISATION_SHARE = 5, 0.5
"""Groups of places that a lost camera is compared with: those with this share of the best similarity."""
_VIEWING_RANGE_M = 15.0
"""How far apart two cameras may be that see the same things well."""
_DOUBT_SHARE, _DOUBT_M = 0.7, 10.0
"""A lost camera stays lost when a place so far from the best one has this share of the best one's inliers."""
_SLACK_M = 1.0
"""What a loop may move the camera by in any case."""
_KNOWN_ROAD_PLACES = 2
"""On a road that a closed loop has tied down, one place in so many is matched."""
_MISSED_ON_THE_WAY_BACK = 3
"""Places in a row that may fail to match before a closed loop is followed back no farther."""
_REFINE_MATCHES, _REFINE_M, _REFINE_DEG = 3, 0.25, 0.5
"""After so many more matches the pose graph is solved again if poses are off by this; after three times as many, or a
tenth of the loops that it has, anyway: its time grows with them, and so a long second round costs no more a loop."""


_VOCABULARY = "vocabulary"
_EDGE = ("first", "second", "T_first_second", "covariance")


@dataclass(frozen=True)
class Closure:
    """What one correction did: ``poses`` (K, 4, 4) T_world_cam of all keyframes; the newest loop joins keyframes
    ``old`` and ``new`` by ``inliers`` points; ``loops`` of all ``known`` loops were believed; ``moved`` keyframes moved
    by more than a centimetre, the farthest by ``farthest_m``."""

    poses: Float
    old: int
    new: int
    inliers: int
    loops: int
    known: int
    moved: int
    farthest_m: float


class LoopCloser:
    """Watches the keyframes of an odometry. ``add`` every keyframe; ``relocalise`` a view that the odometry lost.

    After Galvez-Lopez and Tardos (T-RO 2012) for finding places and Mur-Artal and Tardos (ORB-SLAM2, 2017) for the
    whole; the number of inliers alone accepts false loops where facades repeat, so matches must also agree with each
    other and the odometry, and the pose graph may still refuse them. Deterministic. With ``closing`` False places are
    only kept for ``relocalise``. A place takes about 50 kB (1000 keypoints); all but the newest lie in the archive.
    """

    def __init__(
        self,
        camera: StereoCamera,
        settings: LoopSettings,
        least_disparity: float,
        scale_factor: float,
        vocabulary: Vocabulary | None,
        closing: bool,
        archive: Archive,
        sigma_px: float = 1.0,
    ) -> None:
        """``least_disparity`` in pixels: farther keypoints are no part of a place; ``scale_factor`` from octave to
        octave, and how far keypoints are off, ``sigma_px``, in pixels of the octave; ``archive`` takes what never
        changes. Raises ``BenchError`` when ``closing`` without gtsam."""
        if closing:
            import_gtsam()
        self._camera = camera
        self._set = settings
        self._least_disparity = least_disparity
        self._scale_factor = scale_factor
        self._sigma_px = sigma_px
        self._closing = closing
        self._vocabulary = vocabulary
        self._archive = archive
        self._index = PlaceIndex(len(vocabulary), archive) if vocabulary is not None else None
        self._last_vector: WordVector | None = None
        self._chain = OdometryChain()
        self._places = PlaceList(archive)
        self._at_places: Float = np.empty((0, 4, 4))
        self._runs: list[Run] = []
        self._edges: list[Edge] = []
        self._relocalised_at: int | None = None

    def add(self, keyframe: KeyframeRecord, poses: Float) -> Closure | None:
        """Take in the newest keyframe; ``poses`` (K, 4, 4) T_world_cam of all so far. A closure if a loop closed."""
        self._chain.extend(poses, keyframe.begins_map)
        if keyframe.begins_map and self._relocalised_at is not None:
            self._edges.append(self._chain.tie(self._relocalised_at, keyframe.index, poses))
        self._relocalised_at = None
        if not self._is_new_place(poses):
            return None
        place = Place.of(keyframe.view, keyframe.index, self._least_disparity, self._scale_factor, self._sigma_px)
        self._places.append(place)
        similarities = self._enter_index()
        self._at_places = poses[self._places.keyframes]
        closure = None
        if similarities is not None and self._closing:
            self._follow(similarities)
            closure = self._close(poses)
        self._archive.release()
        return closure

    def state(self) -> dict[str, Any]:
        """All that is needed to go on, for a checkpoint, with what is in the archive."""
        if self._vocabulary is not None and _VOCABULARY not in self._archive:
            self._archive.put(_VOCABULARY, self._vocabulary.arrays())
        edges = {name: np.array([getattr(edge, name) for edge in self._edges]) for name in _EDGE}
        return {
            "chain": self._chain.state(self._archive),
            "places": self._places.state(),
            "index": None if self._index is None else self._index.state(),
            "last_vector": None if self._last_vector is None else to_state(vars(self._last_vector)),
            "runs": [run.state() for run in self._runs],
            "edges": to_state(edges) if self._edges else None,
            "relocalised_at": self._relocalised_at,
            **to_state({"at_places": self._at_places}),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        self._chain.restore(state["chain"], self._archive)
        self._places.restore(state["places"])
        if state["index"] is not None:
            arrays = self._archive.get(_VOCABULARY)
            self._vocabulary = Vocabulary.of_arrays({**arrays, "centroid": as_they_were(arrays["centroid"])})
            self._index = PlaceIndex(len(self._vocabulary), self._archive)
            self._index.restore(state["index"])
        last, edges = state["last_vector"], state["edges"]
        self._last_vector = None if last is None else WordVector(**from_state(last))
        self._runs = [Run.of_state(run) for run in state["runs"]]
        self._edges = (
            []
            if edges is None
            else [
                Edge(int(first), int(second), T, covariance)
                for first, second, T, covariance in zip(*from_state(edges).values(), strict=True)
            ]
        )
        self._relocalised_at = state["relocalised_at"]
        self._at_places = state["at_places"].numpy()

    def relocalise(self, view: View) -> tuple[int, Float] | None:
        """The keyframe whose place the view (of a lost camera) shows, and the pose T_keyframe_cam (4, 4); else None."""
        self._relocalised_at = None
        here = Place.of(view, -1, self._least_disparity, self._scale_factor, self._sigma_px)
        if len(here) < self._set.min_inliers or not self._places:
            return None
        found: list[tuple[int, Verified]] = []
        for old in self._similar_places(here):
            verified = verify(self._camera, self._places[old], here, self._set.min_inliers)
            if verified is not None:
                found.append((int(old), verified))
        if not found:
            return None
        where = np.array([(self._at_places[old] @ verified.T_old_new)[:3, 3] for old, verified in found])
        inliers = np.array([verified.inliers for _, verified in found])
        best = int(inliers.argmax())
        apart = np.linalg.norm(where - where[best], axis=1) > _DOUBT_M
        if (inliers[apart] >= _DOUBT_SHARE * inliers[best]).any():
            return None
        old, verified = found[best]
        self._relocalised_at = self._places[old].keyframe
        return self._relocalised_at, verified.T_old_new

    def _similar_places(self, here: Place) -> Ints:
        """Places that look like this one, and the newest place, where a lost camera most likely is."""
        newest = np.array([len(self._places) - 1])
        if self._index is None or self._vocabulary is None:
            return newest
        scores = self._index.scores(word_vector(self._vocabulary, here.descriptors))
        least = _RELOCALISATION_SHARE * scores.max()
        similar = best_places(scores, np.ones(len(scores), dtype=bool), least, _RELOCALISATION_CANDIDATES)
        return np.unique(np.append(similar, newest))

    def _is_new_place(self, poses: Float) -> bool:
        if not self._places:
            return True
        motion = se3.inverse(poses[self._places[-1].keyframe]) @ poses[-1]
        return not close(motion, self._set.place_spacing_m, self._set.place_rotation_deg)

    def _enter_index(self) -> Float | None:
        """Index the newest place. Similarity of all places (n,) with it, as a share of that of the one before it."""
        if self._vocabulary is None or self._index is None:
            if len(self._places) >= self._set.training_places:
                self._train()
            return None
        vector = word_vector(self._vocabulary, self._places[-1].descriptors)
        scores = self._index.scores(vector)
        usual = 0.0 if self._last_vector is None else similarity(vector, self._last_vector)
        self._index.add(vector)
        self._last_vector = vector
        return np.append(scores / usual if usual > 0 else np.zeros_like(scores), 1.0)

    def _train(self) -> None:
        images = [self._places[number].descriptors[::_TRAINING_SHARE] for number in range(len(self._places))]
        if sum(len(image) for image in images) < _BRANCHING**2:
            return  # Hardly any texture so far: wait for better places.
        self._vocabulary = train(images, _BRANCHING, _DEPTH)
        self._index = PlaceIndex(len(self._vocabulary), self._archive)
        for number in range(len(self._places)):
            self._last_vector = word_vector(self._vocabulary, self._places[number].descriptors)
            self._index.add(self._last_vector)

    def _allowed(self) -> Mask:
        """Places (n,) far enough back, and as near as drift of the odometry can explain."""
        keyframes = self._places.keyframes
        way, bridged = self._chain.way(keyframes, keyframes[-1])
        distance = np.linalg.norm(self._at_places[:, :3, 3] - self._at_places[-1, :3, 3], axis=1)
        near = distance <= _VIEWING_RANGE_M + self._set.max_drift * way + bridged
        return (way >= self._set.min_way_m) & near

    def _follow(self, similarities: Float) -> None:
        """Match the newest place, and let runs of matches go on, begin, or end."""
        new = len(self._places) - 1
        self._runs = [run for run in self._runs if run.alive(new)]
        allowed = self._allowed()
        candidates = self._continued(allowed)
        if not any(run.closed for run in self._runs):
            for old in best_places(similarities, allowed, self._set.min_similarity, _CANDIDATES):
                if all(abs(int(old) - known) > 2 for known in candidates):
                    candidates.append(int(old))
        for old in candidates:
            verified = verify(self._camera, self._places[old], self._places[new], self._set.min_inliers)
            match = None if verified is None else Match(old, new, verified)
            if match is not None and self._drift_explains(match):
                self._enter_match(match)

    def _continued(self, allowed: Mask) -> list[int]:
        """For every run, the old place that is nearest to where the run says that the camera is now."""
        new = len(self._places) - 1
        found: list[int] = []
        for run in self._runs:
            if run.closed and new - run.last.new < _KNOWN_ROAD_PLACES:
                continue
            apart = np.linalg.norm(self._at_places[:, :3, 3] - run.predicted(self._at_places, new)[:3, 3], axis=1)
            apart[~allowed] = np.inf
            old = int(apart.argmin())
            if apart[old] <= _VIEWING_RANGE_M and old not in found:
                found.append(old)
        return found

    def _drift_explains(self, match: Match) -> bool:
        keyframes = self._places.keyframes
        way, bridged = self._chain.way(keyframes[[match.old]], keyframes[match.new])
        measured = self._at_places[match.old] @ match.verified.T_old_new
        move = np.linalg.norm(measured[:3, 3] - self._at_places[match.new, :3, 3])
        return bool(move <= _SLACK_M + self._set.max_drift * way[0] + bridged[0])

    def _enter_match(self, match: Match) -> None:
        keyframes = self._places.keyframes
        for run in self._runs:
            way, _ = self._chain.way(keyframes[[run.last.new]], keyframes[match.new])
            if run.last.new < match.new and run.continues_with(match, self._at_places, float(way[0])):
                run.append(match)
                return
        self._runs.append(Run([match], waiting=1))

    def _close(self, poses: Float) -> Closure | None:
        """Correct the poses if a run has become trustworthy, or if a closed one has more to say."""
        run = next((run for run in self._runs if self._is_ready(run)), None)
        if run is None:
            return None
        edges = [self._edge(match) for match in run.matches[-run.waiting :]]
        corrected, believed = optimise(Graph(*self._chain.steps(), [*self._edges, *edges]), poses)
        run.waiting = 0 if run.closed else run.waiting
        if believed[-len(edges) :].mean() <= 0.5:
            # Odometry speaks against it more strongly than so few matches speak for it: ask again with twice as many.
            run.wanted = 2 * len(run.matches)
            return None
        first, run.closed, run.waiting = not run.closed, True, 0
        self._edges += edges
        self._chain.freeze()
        if first and (earlier := self._earlier_matches(run, corrected)):
            with_them = [*self._edges, *map(self._edge, earlier)]
            again, of_all = optimise(Graph(*self._chain.steps(), with_them), corrected)
            if of_all[-len(earlier) :].mean() > 0.5:
                self._edges, corrected, believed = with_them, again, of_all
        moves = np.linalg.norm(corrected[:, :3, 3] - poses[:, :3, 3], axis=1)
        self._at_places = corrected[self._places.keyframes]
        return Closure(
            corrected,
            edges[-1].first,
            edges[-1].second,
            run.last.verified.inliers,
            int(believed.sum()),
            len(believed),
            int((moves > 0.01).sum()),
            float(moves.max()),
        )

    def _earlier_matches(self, run: Run, poses: Float) -> list[Match]:
        """Matches of the places before a run's first, back to where the two roads met: those that drift beyond
        ``max_drift`` had hidden. From corrected ``poses`` (K, 4, 4) they are where the run says; else few are asked."""
        keyframes, at_places = self._places.keyframes, poses[self._places.keyframes]
        back, missed = Run(run.matches[:1]), 0
        for new in range(run.matches[0].new - _KNOWN_ROAD_PLACES, 0, -_KNOWN_ROAD_PLACES):
            way, _ = self._chain.way(keyframes[:new], keyframes[new])
            apart = np.linalg.norm(at_places[:new, :3, 3] - back.predicted(at_places, new)[:3, 3], axis=1)
            apart[way < self._set.min_way_m] = np.inf
            old = int(apart.argmin())
            near = apart[old] <= _VIEWING_RANGE_M
            verified = (
                verify(self._camera, self._places[old], self._places[new], self._set.min_inliers) if near else None
            )
            since, _ = self._chain.way(keyframes[[new]], keyframes[back.last.new])
            if verified is not None and back.continues_with(
                match := Match(old, new, verified), at_places, float(since[0])
            ):
                back.append(match)
                missed = 0
            else:
                missed += 1
            if missed > _MISSED_ON_THE_WAY_BACK:
                break
        return back.matches[1:]

    def _is_ready(self, run: Run) -> bool:
        if run.last.new != len(self._places) - 1:
            return False
        if not run.closed:
            enough = max(self._set.min_matches, run.wanted)
            return len(run.matches) >= enough and not rival_of(run, self._runs, self._at_places)
        measured = self._at_places[run.last.old] @ run.last.verified.T_old_new
        off = not close(se3.inverse(measured) @ self._at_places[run.last.new], _REFINE_M, _REFINE_DEG)
        return run.waiting >= (_REFINE_MATCHES if off else max(3 * _REFINE_MATCHES, len(self._edges) // 10))

    def _edge(self, match: Match) -> Edge:
        old, new = self._places[match.old].keyframe, self._places[match.new].keyframe
        return Edge(old, new, match.verified.T_old_new, match.verified.covariance)
