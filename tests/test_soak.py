"""The measurement of growth: its slope, the memory of child processes, and recordings that are lost or told twice."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from lab.soak import Curve, growth, lost_or_repeated, resident


def test_the_slope_of_a_curve_with_a_step():
    """10 kB a diagnosis after caches are filled; one step of 3 MB does not sway it, and what fills caches is left out."""
    done = np.arange(1.0, 301.0)
    size = 2e5 + 10.0 * done + 3000.0 * (done > 150) + 500.0 * np.minimum(done, 60.0)
    found = growth("diagnose", list(zip(done, size, strict=True)), 1.0)
    assert found.slope_kb == pytest.approx(10.0, abs=0.5)
    assert found.ci95[0] <= found.slope_kb <= found.ci95[1]
    assert found.count == 300
    assert found.largest_mb == found.last_mb == pytest.approx(size[-1] / 1024)


def test_a_curve_is_on_disk_as_it_grows(tmp_path):
    curve = Curve(tmp_path / "curve.csv")
    curve.add(1, 2048.5)
    assert (tmp_path / "curve.csv").read_text() == "diagnoses,resident_kB\n1,2048.5\n"
    assert curve.points == [(1, 2048.5)]


CHILD = "x = bytearray(60_000_000); print(1, flush=True); input()"
PARENT = f"""
import subprocess, sys, threading
def start():
    child = subprocess.Popen([sys.executable, "-c", {CHILD!r}], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    child.stdout.readline()
    print(child.pid, flush=True)
    input()
    child.communicate(b"\\n")
threading.Thread(target=start).start()
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_children_of_any_thread_are_counted():
    """A child belongs to the thread that started it, as the workers of a cluster do."""
    parent = subprocess.Popen([sys.executable, "-c", PARENT], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    try:
        alone, together = resident(child), resident(parent.pid)
        assert alone > 50_000
        assert 0 < together - alone < 50_000, "the parent itself is small"
    finally:
        parent.communicate(b"\n")
    assert resident(child) == resident(parent.pid) == 0


@pytest.mark.parametrize(
    ("rows", "wrong"),
    [
        ([("0", "missing_physics"), ("1", "no_mismatch")], 0),
        ([("0", "missing_physics")], 1),
        ([("0", "missing_physics"), ("0", "missing_physics"), ("1", "no_mismatch")], 1),
        ([("0", "missing_physics"), ("1", "failed")], 2),
        ([("0", "missing_physics"), ("1", "refused"), ("1", "no_mismatch")], 1),
    ],
)
def test_recordings_that_are_lost_or_told_twice(tmp_path, rows, wrong):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    (tmp_path / "out").mkdir()
    table = {"log": [f"logs/r/{int(n):06d}.npz" for n, _ in rows], "verdict": [v for _, v in rows]}
    pq.write_table(pa.table(table), tmp_path / "out" / "fleet.parquet")
    assert lost_or_repeated(tmp_path, 2) == wrong
