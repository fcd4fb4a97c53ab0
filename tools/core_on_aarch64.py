"""``make aarch64``: the core's kernels built for aarch64, run under qemu-user, and compared with those for x86-64.

Needs an x86-64 processor with AVX2, and Debian's packages ``g++-aarch64-linux-gnu`` and ``qemu-user``. Where no product
joins a sum (``-ffp-contract=off``) all bits must be the same. As shipped, aarch64 rounds a b + c once and x86-64's
baseline twice; x86-64's own kernels for AVX2 round it once too: how far these are from the baseline is the yardstick.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

_BUILD = Path("build/aarch64")
_CROSS = "aarch64-linux-gnu-g++"
_QEMU = "qemu-aarch64"
_LIBRARIES = "/usr/aarch64-linux-gnu"
_MOST = 10.0
"""How many times the yardstick the 0.99 quantile of an array's differences may be."""

Values = dict[str, np.ndarray]
"""What tests/native/core_values.cpp writes, by name: float64 (N,)."""


def main() -> int:
    """Build, run and compare; exit code 1 where bits differ that must not, or values by too much."""
    for command, package in ((_CROSS, "g++-aarch64-linux-gnu"), (_QEMU, "qemu-user")):
        if shutil.which(command) is None:
            print(f"{command} is missing. On Debian: apt-get install {package}", file=sys.stderr)
            return 2
    x86, arm = (_values(_built(processor, "off"), "baseline") for processor in ("x86_64", "aarch64"))
    other = {name: int(np.count_nonzero(x86[name].view(np.uint64) != arm[name].view(np.uint64))) for name in x86}
    numbers = sum(values.size for values in x86.values())
    print(f"-ffp-contract=off: {sum(other.values())} of {numbers} numbers have other bits")
    bad = [name for name, count in other.items() if count]
    fast = _built("x86_64", "fast")
    x86, avx2, arm = _values(fast, "baseline"), _values(fast, "avx2"), _values(_built("aarch64", "fast"), "baseline")
    print(
        "-ffp-contract=fast: 0.99 quantile of the differences from x86-64's baseline, over the array's root mean square"
    )
    print(f"{'array':30} {'numbers':>8} {'aarch64':>9} {'AVX2':>9}")
    for name, values in x86.items():
        distance, yardstick = (_distance(values, each[name]) for each in (arm, avx2))
        bad += [name] if not distance <= _MOST * yardstick else []
        print(f"{name:30} {values.size:8} {distance:9.1e} {yardstick:9.1e}")
    if bad:
        print(f"too far from x86-64: {', '.join(bad)}", file=sys.stderr)
    return 1 if bad else 0


def _distance(values: np.ndarray, others: np.ndarray) -> float:
    return float(np.quantile(np.abs(others - values), 0.99) / np.sqrt(np.mean(np.square(values))))


def _built(processor: str, contract: str) -> list[str]:
    """The command that runs the program, built for ``processor``."""
    folder = _BUILD / f"{processor}-{contract}"
    cross = [] if processor == "x86_64" else [f"-DCMAKE_CXX_COMPILER={_CROSS}"]
    settings = ["-DBGS_PROGRAM=ON", "-DCMAKE_BUILD_TYPE=Release", f"-DBGS_FP_CONTRACT={contract}"]
    settings += ["-DCMAKE_SYSTEM_NAME=Linux", f"-DCMAKE_SYSTEM_PROCESSOR={processor}", *cross]
    cmake = [sys.executable, "-m", "cmake"]
    subprocess.run([*cmake, "-S", ".", "-B", folder, *settings], check=True, stdout=subprocess.DEVNULL)
    subprocess.run([*cmake, "--build", folder], check=True, stdout=subprocess.DEVNULL)
    return [*([] if processor == "x86_64" else [_QEMU, "-L", _LIBRARIES]), str(folder / "core_values")]


def _values(command: list[str], kernels: str) -> Values:
    written = subprocess.run(
        command, check=True, stdout=subprocess.PIPE, env=os.environ | {"BGS_KERNELS": kernels}
    ).stdout
    found = {}
    while written:
        head, _, written = written.partition(b"\n")
        name, _, count = head.decode().rpartition(" ")
        size = 8 * int(count)
        found[name], written = np.frombuffer(written[:size]), written[size:]
    return found


if __name__ == "__main__":
    sys.exit(main())
