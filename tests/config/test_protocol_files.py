"""The protocols that can be chosen by name."""

from __future__ import annotations

import pytest

from bench.config import compose_run
from bench.errors import BenchError


def test_the_papers_protocol_scores_every_left_image_and_every_return() -> None:
    protocol = compose_run(["protocol=paper"]).protocol
    assert protocol.name == "paper"
    assert not any(protocol.is_held_out(number) for number in range(100))
    assert not protocol.right_view
    assert (protocol.depth_min_m, protocol.depth_max_m, protocol.alignment) == (0.0, None, "se3")
    assert (protocol.sky, protocol.depth_mask, protocol.ssim) == ("in", "all", "skimage-gaussian")


def test_the_heldout_protocol_keeps_every_fifth_left_image_and_the_right_camera_for_scoring() -> None:
    protocol = compose_run(["protocol=heldout"]).protocol
    assert protocol.name == "heldout"
    assert [number for number in range(12) if protocol.is_held_out(number)] == [2, 7]
    assert protocol.right_view


@pytest.mark.slow
def test_a_named_protocol_can_be_changed_and_checks_its_values() -> None:
    assert compose_run(["protocol=paper", "protocol.ssim=ms-ssim"]).protocol.ssim == "ms-ssim"
    assert compose_run(["protocol=paper", "protocol.sky=out"]).protocol.stamp()["sky"] == "out"
    with pytest.raises(BenchError, match=r"protocol\.sky=out needs protocol\.right_view=false"):
        compose_run(["protocol=heldout", "protocol.sky=out"])
    with pytest.raises(BenchError, match=r"protocol has no setting 'skies'; .*Did you mean 'sky'\?"):
        compose_run(["protocol=paper", "protocol.skies=out"])
    with pytest.raises(BenchError, match=r"protocol='papr' is not one of default, heldout, paper"):
        compose_run(["protocol=papr"])


def test_protocols_are_part_of_what_a_run_is() -> None:
    hashes = {compose_run([f"protocol={name}"]).hash for name in ("default", "paper", "heldout")}
    assert len(hashes) == 3
