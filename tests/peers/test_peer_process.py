"""Child processes that answer, crash, hang or talk nonsense, and that nothing of them is left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.peers.messages import Message
from bench.peers.process import PeerFailure, PeerProcess
from bench.process_memory import peers_peak_gb
from bench.runs.memory import PeakMemory

FAKE = [sys.executable, "-P", str(Path(__file__).parent / "fake_peer.py")]
IMAGE = np.full((300, 1000), 7, np.uint8)  # several times what a pipe holds

OWNER = """
import sys, time
from bench.peers.process import PeerProcess
from bench.peers.messages import Message
peer = PeerProcess({command!r})
peer.request(Message("start", {{"settings": {{}}}}), 20)
print(peer.pid, peer._scratch.name, flush=True)
{then}
"""


def frame(number: int) -> Message:
    return Message("track", {"number": number, "timestamp": 0.1 * number}, {"left": IMAGE, "right": IMAGE})


def started(**settings: Any) -> PeerProcess:
    peer = PeerProcess(FAKE)
    peer.request(Message("start", {"settings": settings}), 20)
    return peer


def is_gone(pid: int, within_s: float = 0.0) -> bool:
    """Whether there is no such process, not even a zombie that is ours to wait for."""
    end = time.monotonic() + within_s
    while _is_there(pid):
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


def _is_there(pid: int) -> bool:
    try:
        state, parent = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[:2]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z" or int(parent) == os.getpid()


@pytest.fixture
def peer() -> Iterator[PeerProcess]:
    process = started(events={"1": "segfault", "2": "exit", "3": "hang", "5": "raise"})
    yield process
    process.close()


def test_a_peer_answers(peer: PeerProcess) -> None:
    answer = peer.request(frame(0), 20)
    assert answer.kind == "pose"
    assert answer.fields == {"state": "ok", "map": 0, "inliers": 40}
    np.testing.assert_array_equal(answer.arrays["T_map_cam"], np.eye(4))


@pytest.mark.parametrize(
    ("number", "reason"),
    [
        (1, "was killed by SIGSEGV; its last words: what a peer prints is no answer"),
        (2, "ended with exit code 3; its last words: out of luck"),
        (3, "gave no answer within 0.5 s and was killed"),
    ],
)
def test_how_a_peer_failed_is_told(peer: PeerProcess, number: int, reason: str) -> None:
    start = time.monotonic()
    with pytest.raises(PeerFailure) as failure:
        peer.request(frame(number), 0.5)
    assert str(failure.value) == reason
    assert time.monotonic() - start < 5
    assert is_gone(peer.pid)
    with pytest.raises(PeerFailure, match="is not running"):
        peer.request(frame(9), 1)


def test_output_that_is_no_answer_is_told() -> None:
    shouting = [sys.executable, "-c", "import sys; sys.stdout.write('Segmentation fault' * 9); sys.stdin.read()"]
    peer = PeerProcess(shouting)
    with pytest.raises(PeerFailure, match="wrote something that is no answer: it begins with b'Segm'"):
        peer.request(Message("start"), 10)
    assert is_gone(peer.pid)


def test_a_peer_that_does_not_read_is_a_hang() -> None:
    peer = PeerProcess([sys.executable, "-c", "import time; time.sleep(60)"])
    with pytest.raises(PeerFailure, match=r"gave no answer within 0\.3 s"):
        peer.request(frame(0), 0.3)
    assert is_gone(peer.pid)


def test_what_the_peer_raises_is_its_answer(peer: PeerProcess) -> None:
    answer = peer.request(frame(5), 20)
    assert answer.kind == "refused"
    assert answer.fields["reason"] == "RuntimeError: frame without a name"


def test_a_program_that_does_not_exist() -> None:
    with pytest.raises(PeerFailure, match=r"could not be started .*No such file"):
        PeerProcess(["/nowhere/orbslam"])


def test_closing_leaves_no_process_and_no_folder() -> None:
    peer = PeerProcess([*FAKE, "grandchild"])
    peer.request(Message("start", {"settings": {}}), 20)
    children = Path(f"/proc/{peer.pid}/task/{peer.pid}/children").read_text().split()
    scratch = Path(peer._scratch.name)
    assert len(children) == 1
    assert scratch.is_dir()
    peer.close()
    peer.close()
    assert is_gone(peer.pid)
    assert is_gone(int(children[0]), within_s=5)
    assert not scratch.exists()


def test_letting_go_of_a_peer_ends_it() -> None:
    peer = started()
    pid = peer.pid
    del peer
    assert is_gone(pid)


def test_the_peer_has_its_own_session_so_that_ctrl_c_does_not_reach_it(peer: PeerProcess) -> None:
    assert os.getsid(peer.pid) == peer.pid != os.getsid(0)


@pytest.mark.parametrize("then", ["", "raise ValueError", "import os; os.kill(os.getpid(), 2); time.sleep(9)"])
def test_a_peer_ends_with_the_python_that_owns_it(then: str) -> None:
    owner = subprocess.run(
        [sys.executable, "-c", OWNER.format(command=FAKE, then=then)], capture_output=True, text=True, timeout=30
    )
    pid, scratch = owner.stdout.split()
    assert is_gone(int(pid), within_s=5)
    assert not Path(scratch).exists()


def test_a_peer_ends_when_its_owner_is_killed() -> None:
    code = OWNER.format(command=FAKE, then="peer.request(Message('finish'), 20); time.sleep(60)")
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as owner:
        assert owner.stdout is not None
        pid, scratch = owner.stdout.readline().split()
        assert not is_gone(int(pid))
        owner.send_signal(signal.SIGKILL)
    assert is_gone(int(pid), within_s=5)
    Path(scratch).rmdir()


def test_what_a_peer_eats_is_part_of_the_run_s_memory() -> None:
    """The peer takes 0.3 GB more; the bench's own high-water mark knows nothing of it."""
    with_peer = PeakMemory()
    peer = started(events={"1": "eat"})
    peer.request(frame(0), 20)
    before = peers_peak_gb()
    peer.request(frame(1), 20)
    peer.close()
    assert peers_peak_gb() - before == pytest.approx(0.3, abs=0.03)
    assert with_peer.host_gb() > peers_peak_gb() > 0.3
    PeakMemory()
    assert peers_peak_gb() == 0.0
