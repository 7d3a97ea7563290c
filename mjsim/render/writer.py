"""Writing a film: frames to mp4, gif or png; nothing half-made under the final name."""

from __future__ import annotations

import itertools
import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from mjsim.errors import InputError, nearest, writing

__all__ = ["SUFFIXES", "need_suffix", "save"]

SUFFIXES = (".mp4", ".gif", ".png")


def need_suffix(path: Path) -> None:
    """Raise InputError when no film can be written to a file of this ending."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(path, f"unknown kind of film {path.suffix!r}", ", ".join(SUFFIXES),
                         nearest(path.suffix.lower(), SUFFIXES, "choose another name"))  # fmt: skip


def save(frames: Iterator[np.ndarray], path: Path, fps: float) -> None:
    """Write frames (height, width, 3) to a .mp4, .gif or .png (the first one): under a temporary name, then rename.

    Raises InputError when the encoder fails; a place that cannot be written is an OSError. Nothing is left in either case.
    """
    kind = path.suffix.lower()
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=kind, dir=path.parent)
    os.close(handle)
    try:
        with writing(path):
            if kind == ".mp4":
                _encode(frames, name, fps)
            elif kind == ".png":
                Image.fromarray(next(frames)).save(name)
            else:
                pictures = [Image.fromarray(frame).quantize(128) for frame in frames]
                pictures[0].save(name, save_all=True, append_images=pictures[1:], duration=round(1000 / fps), loop=0)
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _encode(frames: Iterator[np.ndarray], name: str, fps: float) -> None:
    """H.264 by the ffmpeg that imageio-ffmpeg brings."""
    from imageio_ffmpeg import get_ffmpeg_exe

    first = next(frames)
    height, width = first.shape[:2]
    command = [
        get_ffmpeg_exe(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
        "-r", f"{fps:g}", "-i", "-", "-an", "-c:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p",
        "-movflags", "+faststart", name,
    ]  # fmt: skip
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stderr is not None
        try:
            for frame in itertools.chain([first], frames):
                process.stdin.write(frame.tobytes())
            process.stdin.close()
        except BrokenPipeError:
            pass  # ffmpeg says below why it ended
        except BaseException:
            process.kill()
            raise
        said = process.stderr.read().decode(errors="replace").strip()
        if process.wait() != 0:
            raise InputError(Path(name).name, f"ffmpeg failed ({' '.join(said.split())[:200]})", todo="write a .gif instead")
