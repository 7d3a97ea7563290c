"""The quick grade as a user runs it (`make proof`): 25 concealed cases, and no bar that their few can refute is refuted."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lab.benchmark.grade import GRADES


@pytest.mark.slow
def test_the_quick_grade(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    began = time.monotonic()
    subprocess.run([sys.executable, "-m", "simgap", "benchmark", "--out", str(tmp_path), "--grade", "quick"], check=True)
    summary = json.loads((tmp_path / "benchmark.json").read_text(encoding="utf-8"))
    with capsys.disabled():
        print(f"\nquick grade: {time.monotonic() - began:.0f} s, {summary['n']} cases")
        for bar in summary["bars"]:
            print(f"  {bar['status']:>13}  {bar['value']}  of {bar['n']}  {bar['id']}")
    assert summary["n"] == sum(GRADES["quick"].values())
    assert not summary["errors"]
    refuted = [bar["text"] for bar in summary["bars"] if bar["status"] == "fails" and bar["certain"]]
    assert refuted == []
