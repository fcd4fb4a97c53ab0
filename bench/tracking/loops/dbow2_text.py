"""Write a vocabulary in the text format of DBoW2, which ORB-SLAM2 and ORB-SLAM3 read.

The first line holds the branching factor, the depth, the scoring (0 = L1) and the weighting (0 = tf-idf). Each further
line is a node, numbered from 1 in the order of the lines (0 is the root, which has none): the number of its parent, 1
for a leaf or 0, the 32 bytes of its descriptor, its weight. Format: Galvez-Lopez and Tardos, "Bags of binary words for
fast place recognition in image sequences", T-RO 2012, and the text variant that came with ORB-SLAM2.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.tracking.loops.vocabulary import Vocabulary

_SCORING_L1 = 0
_WEIGHTING_TF_IDF = 0


def dbow2_text(vocabulary: Vocabulary) -> str:
    """The file's content; node and word numbers are those of ``vocabulary``."""
    rows = np.column_stack(
        [vocabulary.parent, vocabulary.is_leaf, vocabulary.centroid.view(np.uint8).reshape(-1, 32).astype(np.int64)]
    )[1:]
    lines = [f"{vocabulary.branching} {vocabulary.depth} {_SCORING_L1} {_WEIGHTING_TF_IDF}"]
    for row, weight in zip(rows.tolist(), vocabulary.idf[1:].tolist(), strict=True):
        lines.append(f"{' '.join(map(str, row))} {weight:.9g}")
    # Readers take a line end at the end for one more node.
    return "\n".join(lines)


def write_dbow2(path: Path, vocabulary: Vocabulary) -> None:
    """Write the tree as a DBoW2 text file."""
    path.write_text(dbow2_text(vocabulary), encoding="ascii")
