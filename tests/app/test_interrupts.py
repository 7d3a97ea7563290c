"""Interrupts of the app and of the process that draws pictures."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

pytest.importorskip("starlette", reason="starlette is not installed: pip install simgap[app]")

from simgap.app import preview


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no signal mask")
def test_an_interrupt_while_the_drawing_process_starts_does_not_end_it(tmp_path, monkeypatch):
    (tmp_path / "a.csv").write_text("t,torque_Nm\n" + "".join(f"{0.01 * k:.2f},{k % 3}\n" for k in range(100)))
    monkeypatch.setattr(preview, "PATIENCE", 300.0)
    previews = preview.Previews()
    previews.start()
    process = previews._pool._pool[0]
    os.kill(process.pid, signal.SIGINT)
    previews.picture(tmp_path, "a.csv", "")
    assert process.is_alive()
    assert previews._pool._pool == [process]
    previews.close()


@pytest.mark.slow
def test_an_interrupt_before_the_server_has_started_is_no_error(tmp_path):
    words = [sys.executable, "-m", "simgap", "app", "--no-browser", "--folder", str(tmp_path / "runs")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline().startswith("simgap app: http://127.0.0.1:")
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
        assert process.stderr.read() == ""
