"""Scoring a stereo plugin in a process of its own: its memory is its own, and when it breaks, nothing else does."""

from __future__ import annotations

import multiprocessing
import os
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection

from bench import registry
from bench.config import RunConfig
from bench.discovery import load_plugins
from bench.errors import BenchError
from bench.evaluation.stereo_backbone import BackboneScore, Progress, score_backbone


@dataclass(frozen=True)
class Broken:
    """Why a backbone has no score, in one line."""

    reason: str


def score_in_process(config: RunConfig, warm_up: int, on_progress: Progress | None = None) -> BackboneScore | Broken:
    """Score the config's stereo plugin on its data set in a new process; what goes wrong there comes back as words."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_score, args=(theirs, config, warm_up), daemon=True)
    with _without_the_current_folder():
        process.start()
    # The only writing end left is the child's, so that its death ends `recv`.
    theirs.close()
    try:
        while True:
            message = ours.recv()
            if isinstance(message, (BackboneScore, Broken)):
                return message
            if on_progress is not None:
                on_progress(*message)
    except (EOFError, OSError):  # the second in the middle of a message
        process.join()
        return Broken(_how_it_died(process.exitcode))
    finally:
        process.terminate()
        process.join()


@contextmanager
def _without_the_current_folder() -> Iterator[None]:
    """A Python that is started in the block takes no module from the current folder, as with ``-P``."""
    name = "PYTHONSAFEPATH"
    before = os.environ.get(name)
    os.environ[name] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def _score(results: Connection, config: RunConfig, warm_up: int) -> None:
    try:
        load_plugins(config.values["plugins"])
        dataset = registry.build(config.plugin("dataset"), "dataset")
        source = registry.build(config.plugin("stereo"), "stereo")
        results.send(score_backbone(dataset, source, warm_up, lambda done, total: results.send((done, total))))
    except BenchError as error:
        results.send(Broken(str(error)))
    except KeyboardInterrupt:
        # The parent got it, too, and says so.
        return
    except Exception as error:
        raised = traceback.extract_tb(error.__traceback__)[-1]
        words = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(":")
        results.send(Broken(f"{words} ({raised.filename}, line {raised.lineno})"))


def _how_it_died(code: int | None) -> str:
    if code is not None and code < 0:
        # What Linux does to a process when memory runs out.
        memory = ", perhaps out of memory" if code == -9 else ""
        return f"its process was killed by signal {-code}{memory}"
    return f"its process ended with code {code}"
