"""Counts of tracking states and lost stretches, worked by hand."""

from __future__ import annotations

import numpy as np

from bench.evaluation.frame_states import count_states, describe_stretches, stretches


def test_states_are_counted_and_lost_ones_found() -> None:
    states = ["lost", "ok", "weak", "lost", "lost", "predicted", "lost"]
    assert count_states([10, 12, 14, 16, 18, 20, 22], states) == {
        **{"tracked": 3, "ok": 1, "weak": 1, "predicted": 1, "lost": 4},
        "lost_stretches": [[10, 10], [16, 18], [22, 22]],
    }
    assert count_states([], []) == {"tracked": 0, "ok": 0, "weak": 0, "predicted": 0, "lost": 0, "lost_stretches": []}


def test_all_or_nothing_is_one_stretch_or_none() -> None:
    assert stretches([3, 4, 5], np.ones(3, bool)) == [[3, 5]]
    assert stretches([3, 4, 5], np.zeros(3, bool)) == []


def test_stretches_in_words() -> None:
    assert describe_stretches([[40, 51], [80, 80]]) == "40 to 51, 80"
    assert describe_stretches([[i, i] for i in range(0, 16, 2)]) == "0, 2, 4, 6, 8 and 3 more stretches"
