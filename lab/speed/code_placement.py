"""How the pace of one run hangs on the physical memory under its compiled code: ``python lab/speed/code_placement.py``; Linux.

The same run of Stribeck friction beside a hardening spring, 2 s at 2 kHz in steps of 25 us, in one process. Between two timings
every page that holds code compiled in this process is copied to fresh memory, which is then mapped to the page's own address:
nothing differs but where the page lies in physical memory. It judges nothing.
"""

from __future__ import annotations

import argparse
import ctypes
import sys
import time
from pathlib import Path

from start_and_kernel import DT, axes, chirp

from mjsim.ode import simulate
from mjsim.system import assemble

READ_WRITE, READ_EXECUTE, PRIVATE_ANONYMOUS, MOVE_TO = 3, 5, 0x22, 3
TIMINGS = 5


def code() -> list[tuple[int, int]]:
    """(address, bytes) of every stretch of memory that is executable and of no file: what was compiled."""
    fields = (line.split() for line in Path("/proc/self/maps").read_text().splitlines())
    stretches = [f[0].split("-") for f in fields if f[1].startswith("r-x") and len(f) == 5]
    return [(int(a, 16), int(b, 16) - int(a, 16)) for a, b in stretches]


def move(libc: ctypes.CDLL, address: int, size: int) -> None:
    """Put fresh memory with the same bytes under an address. Raises OSError where the system refuses."""
    fresh = libc.mmap(None, size, READ_WRITE, PRIVATE_ANONYMOUS, -1, 0)
    ctypes.memmove(fresh, address, size)
    if libc.mprotect(fresh, size, READ_EXECUTE) or libc.mremap(fresh, size, size, MOVE_TO, address) != address:
        raise OSError(ctypes.get_errno(), "the code could not be moved")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moves", type=int, default=12)
    arguments = parser.parse_args()
    if sys.platform != "linux":
        sys.exit("code_placement.py: memory is moved by Linux's mremap: run it there")
    libc = ctypes.CDLL(None, use_errno=True)
    libc.mmap.restype = libc.mremap.restype = ctypes.c_void_p
    libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long]
    libc.mremap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t, ctypes.c_int, ctypes.c_void_p]
    libc.mprotect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    torque = chirp(2.0, DT, 1.0, 0.5, 30.0)
    system = assemble(axes()["Stribeck + hardening"]).resolved(DT)

    def seconds() -> float:
        began = time.perf_counter()
        simulate(system, torque, DT, substeps=20)
        return time.perf_counter() - began

    seconds()  # loads, or compiles
    stretches = code()
    print(f"{len(stretches)} stretches of compiled code, {sum(size for _, size in stretches) / 1024:.0f} KiB")
    print(f"the least of {TIMINGS} runs, twice in a row [ms]:")
    paces = []
    for turn in range(arguments.moves + 1):
        if turn:
            for address, size in stretches:
                move(libc, address, size)
        first, again = (min(seconds() for _ in range(TIMINGS)) for _ in range(2))
        paces.append(first)
        print(f"  {'as loaded' if not turn else f'moved {turn:2d}':10s} {1e3 * first:6.1f}  {1e3 * again:6.1f}")
    print(f"slowest over fastest: {max(paces) / min(paces):.2f}")


if __name__ == "__main__":
    main()
