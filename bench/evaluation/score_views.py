"""All evaluators of pictures on all saved views: frames on all cores, each one's scores on disk when it is done."""

from __future__ import annotations

import hashlib
import json
import logging
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from itertools import islice
from typing import Any

import torch

from bench.contracts.evaluator import ViewEvaluator
from bench.errors import BenchError
from bench.evaluation.saved_run import SavedRunFolder
from bench.evaluation.scores_file import Line, ScoresFile, pictures_of, read_scores
from bench.runs.fingerprint import fingerprint
from bench.runs.folder import FRAMES_FILE, SCORES_FILE, View, picture_path

log = logging.getLogger(__name__)

Scores = dict[str, dict[tuple[View, int], dict[str, Any]]]
"""What each evaluator gave of each view: by its name, then by camera and frame number, in the order of the frames."""
_MOST_WORKERS = 1024
_AHEAD = 2
"""How many frames a worker are asked for at once: more would only wait for their turn."""


def score_views(run: SavedRunFolder, evaluators: Mapping[str, ViewEvaluator]) -> Scores:
    """What the evaluators (by name; started here) give of each view of ``run``.

    Each frame is scored by one thread, and torch computes with one in it, so that the numbers are the same to the bit
    for any number of workers (the run's ``threads``; 0: all cores, or OMP_NUM_THREADS). A worker holds one frame: its
    pictures, its references and the activations of LPIPS's network, 0.1 GB at 1226x370. What a scoring that was stopped
    has left is taken where ``_identity`` and the files of the pictures are the same, and three of its frames still have
    the same scores.
    """
    scores: Scores = {name: {} for name in evaluators}
    if not evaluators:
        return scores
    for evaluator in evaluators.values():
        evaluator.start(run)
    scoring = _Scoring(run, evaluators)
    path, identity = run.path / SCORES_FILE, _identity(run, evaluators)
    with _workers(run) as workers:
        kept = scoring.still_right(read_scores(path, identity), workers)
        left = [number for number in scoring.viewed if number not in kept]
        run.report_progress("views", len(kept), len(scoring.viewed))
        with closing(ScoresFile(path, identity, kept.values())) as file:
            for done, line in enumerate(scoring.lines(left, workers), len(kept) + 1):
                file.append(line)
                run.report_progress("views", done, len(scoring.viewed))
            lines = file.read()
    for number in scoring.viewed:
        _, _, of_frame = lines[number]
        for camera, of_view in of_frame.items():
            for name, values in of_view.items():
                scores[name][camera, number] = values
    return scores


class _Scoring:
    """One run and its evaluators; ``viewed`` says which cameras' views of which frames they score."""

    def __init__(self, run: SavedRunFolder, evaluators: Mapping[str, ViewEvaluator]) -> None:
        self._run, self._evaluators = run, evaluators
        self.viewed = run.viewed()

    def line(self, number: int) -> Line:
        """What each evaluator gives of each view of the frame, as JSON gives it back."""
        pictures = self._pictures(number)
        found: dict[View, dict[str, Any]] = {}
        for view in self._run.views_of(number, self.viewed[number]):
            given = {name: evaluator.view(view) for name, evaluator in self._evaluators.items()}
            found[view.camera] = {name: values for name, values in given.items() if values is not None}
        try:
            return number, pictures, json.loads(json.dumps(found))
        except TypeError as error:
            raise BenchError(
                f"An evaluator's view() gave what JSON can't hold ({error}). Return plain numbers."
            ) from error

    def lines(self, numbers: list[int], workers: ThreadPoolExecutor) -> Iterator[Line]:
        """The lines of these frames in their order, some of which are computed at once."""
        coming = iter(numbers)
        waiting: deque[Future[Line]] = deque()
        while True:
            room = _AHEAD * workers._max_workers - len(waiting)
            waiting.extend(workers.submit(self.line, number) for number in islice(coming, room))
            if not waiting:
                return
            yield waiting.popleft().result()

    def still_right(self, kept: dict[int, Line], workers: ThreadPoolExecutor) -> dict[int, Line]:
        """Those of the kept lines whose pictures are still the same; none where one of three frames is scored
        otherwise now: then something has changed that its settings don't show."""
        same = {n: line for n, line in kept.items() if n in self.viewed and line[1] == self._pictures(n)}
        numbers = list(same)
        probes = sorted({numbers[0], numbers[len(numbers) // 2], numbers[-1]}) if numbers else []
        if any(json.dumps(line) != json.dumps(same[line[0]]) for line in self.lines(probes, workers)):
            log.warning("the scores so far are not those that the same frames get now: all frames are scored again")
            return {}
        if same:
            log.info("going on with the scoring: %d of %d frames are scored", len(same), len(self.viewed))
        return same

    def _pictures(self, number: int) -> list[list[int] | None]:
        return pictures_of(
            picture_path(self._run.path, camera, what, number)
            for camera in self.viewed[number]
            for what in ("color", "depth")
        )


def _identity(run: SavedRunFolder, evaluators: Mapping[str, ViewEvaluator]) -> str:
    """Hash of what the scores of all frames depend on: settings of data set, protocol and evaluators, the run's frames
    with the checksums of the images that it read, weights, code, packages, machine."""
    settings = {key: run.config.get(key) for key in ("dataset", "protocol", "evaluator")}
    frames = hashlib.sha256((run.path / FRAMES_FILE).read_bytes()).hexdigest()
    plugins = [*(type(evaluator) for evaluator in evaluators.values()), type(run.dataset)]
    return fingerprint(json.dumps([settings, frames], sort_keys=True, default=str), plugins, run.weights)


@contextmanager
def _workers(run: SavedRunFolder) -> Iterator[ThreadPoolExecutor]:
    """Threads in each of which torch computes with one thread: faster than two threads on one frame."""
    asked, before = run.config.get("threads"), torch.get_num_threads()
    count = asked if isinstance(asked, int) and 0 < asked <= _MOST_WORKERS else before
    pool = ThreadPoolExecutor(count, "scoring", lambda: torch.set_num_threads(1))
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)
        torch.set_num_threads(before)
