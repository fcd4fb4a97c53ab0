"""Events: lines of JSON that come back as they were, sentences for people, and refusals that name the plugin."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.errors import BenchError
from bench.evaluation.frame_states import stretches
from bench.runs.events import check_events, in_words, read_events, write_events
from bench.slam.progress import Progress
from bench.types import Event

CLOSED = Event(
    "loop_closed",
    422,
    {"to_frame": 2, "inliers": 499, "loops_believed": 3, "loops": 4, "keyframes_moved": 411, "keyframes": 423}
    | {"farthest_m": 5.345},
)


def test_events_are_lines_of_json_that_come_back(tmp_path: Path) -> None:
    events = [CLOSED, Event("lost", 423), Event("mine", 424, {"what": ["é", 0.1 + 0.2]})]
    write_events(tmp_path, events)
    lines = [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()]
    assert lines[1] == {"kind": "lost", "frame": 423, "values": {}}
    assert lines[2]["values"]["what"][1] == 0.1 + 0.2
    assert read_events(tmp_path) == events
    assert read_events(tmp_path / "elsewhere") == []


def test_people_read_sentences() -> None:
    assert in_words(CLOSED) == (
        "loop closed: frame 422 sees the place of frame 2 (499 inliers; 3 of 4 loops believed); 411 of 423 tracker "
        "keyframes moved, the farthest by 5.34 m"
    )
    assert in_words(Event("lost", 7)) == "frame 7: tracking is lost"
    assert in_words(Event("loop_closed", 7, {"to_frame": 1})) == "frame 7: loop_closed (to_frame 1)"
    assert in_words(Event("chunk_written", 8)) == "frame 8: chunk_written"


@pytest.mark.parametrize("value", [np.int64(3), float("nan"), Path("x")])
def test_values_that_are_no_plain_data_name_the_plugin(value: object) -> None:
    with pytest.raises(BenchError, match=r"Mine\.track gave an event 'seen' of frame 5 .*expected plain data"):
        check_events([Event("seen", 5, {"it": value})], "Mine.track")


def test_warnings_of_a_run() -> None:
    """Those of its events as they are; frames without depth together."""
    done = Progress(rows=[{"state": "ok", "mapped": True, "number": number} for number in range(4)])
    assert done.warnings() == []
    done.note([Event("warning", 0, {"text": "It is dark."}), Event("lost", 1)])
    done.note([Event("no_depth", number, {"source": "Sgbm"}) for number in (2, 3)])
    assert done.warnings() == [
        "It is dark.",
        "Sgbm knew no depth at all in 2 of 4 keyframes, frame 2 first",
    ]
    assert in_words(done.events[0]) == "It is dark."


def test_what_is_told_of_a_long_run_looks_at_each_frame_once() -> None:
    """Asked at odd moments the lost stretches are those of the evaluation, and asking again looks at nothing."""
    looked: list[int] = []

    class Rows(list[dict[str, Any]]):
        def __getitem__(self, at: Any) -> Any:
            looked.append(at)
            return super().__getitem__(at)

        def __iter__(self) -> Any:
            looked.extend(range(len(self)))
            return super().__iter__()

    random = np.random.default_rng(0)
    lost = random.random(300) < 0.4
    done = Progress(rows=Rows())
    for number, is_lost in enumerate(lost):
        done.rows.append({"number": 2 * number, "state": "lost" if is_lost else "ok", "mapped": not is_lost})
        if random.random() < 0.2:
            assert done.lost_stretches() == stretches(range(0, 600, 2), lost[: number + 1])
    done.note([Event("no_depth", 0, {"source": "Sgbm"})])
    assert f"in 1 of {300 - lost.sum()} keyframes" in done.warnings()[0]
    assert len(looked) < 6 * 300
    looked.clear()
    assert len(done.lost_stretches()) == len(stretches(range(600), lost))
    assert done.warnings()
    assert looked == []
