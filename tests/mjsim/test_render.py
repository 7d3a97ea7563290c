"""Films: what is drawn follows the motion, says how it is magnified, and is never half-written."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from click.testing import CliRunner
from robot_axis import DT, axis, chirp, effect

from mjsim import ode
from mjsim.errors import InputError
from mjsim.models import shipped_model, shipped_models
from mjsim.recording import Recording
from mjsim.render import Shot, context, film, shot_of_recording, shot_of_run
from mjsim.render.stage import Stage, magnify
from simgap.commands.render import command

MODEL = axis(effect("backlash", gap_rad=1e-3))


@pytest.fixture(scope="module")
def motion() -> ode.Trajectory:
    return ode.simulate(MODEL, chirp(1.0, amplitude=2.0), DT)


@pytest.fixture(scope="module")
def shot(motion: ode.Trajectory) -> Shot:
    return shot_of_run("simulation", MODEL, motion)


@pytest.fixture(scope="module")
def screen(shot: Shot) -> None:
    try:
        stage = Stage(shot.chain, shot.half_gaps, magnify(shot.chain, shot.q, shot.half_gaps, 10))
        with context.Offscreen(stage.model, 64, 48):
            pass
    except InputError as error:
        pytest.skip(str(error))


def test_jaws_stand_apart_by_the_gap(shot: Shot) -> None:
    by = magnify(shot.chain, shot.q, 2 * shot.half_gaps, 10)
    stage = Stage(shot.chain, shot.half_gaps, by)
    open_gap = np.zeros(3)
    data = stage.pose(open_gap, 0.0)
    upper, lower = (float(data.joint(f"jaw0{s}").qpos[0]) for s in "ab")
    np.testing.assert_allclose(upper - lower, by.windup * 1e-3)
    lug = stage.model.geom("lug0").id
    assert stage.model.geom_rgba[lug][1] > 0.5  # green: floating
    stage.pose(np.array([118 * 8e-4, 0.0, 0.0]), 0.0)
    assert stage.model.geom_rgba[lug][0] > 0.5  # red: driving
    assert f"wind-up and gap x {by.windup:g}" in by.said


@pytest.mark.usefixtures("screen")
@pytest.mark.parametrize("name", ["a.png", "a.gif", "a.mp4"])
def test_each_format(name: str, shot: Shot, tmp_path: Path) -> None:
    path = film([shot], tmp_path / name, size=(160, 120), fps=10, start=0.2, duration=0.3)
    if name.endswith("mp4"):
        from imageio_ffmpeg import count_frames_and_secs

        assert count_frames_and_secs(str(path)) == (4, pytest.approx(0.4, abs=0.11))
    else:
        picture = iio.imread(path, index=0)
        assert picture.shape[:2] == (120, 160)
        assert float(np.std(np.asarray(picture[..., :3], float))) > 20
    assert [p.name for p in tmp_path.iterdir()] == [name]


@pytest.mark.usefixtures("screen")
def test_side_by_side_and_what_was_not_measured(motion: ode.Trajectory, shot: Shot, tmp_path: Path) -> None:
    record = Recording(motion.time, motion.torque, motion.velocity + 1.0, None, DT)
    recorded = shot_of_recording("recording", MODEL, record)
    assert recorded.gear_torque is None
    assert not recorded.whole
    path = film([shot, recorded], tmp_path / "two.png", size=(160, 120))
    assert iio.imread(path).shape == (120, 320, 3)


@pytest.mark.usefixtures("screen")
def test_a_film_that_breaks_leaves_nothing(shot: Shot, tmp_path: Path) -> None:
    def broken(frames: object, count: int) -> object:
        yield 0
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        film([shot], tmp_path / "b.mp4", size=(160, 120), progress=broken)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_no_library_names_the_packages(monkeypatch: pytest.MonkeyPatch, shot: Shot, tmp_path: Path) -> None:
    monkeypatch.setattr(context.ctypes.util, "find_library", lambda name: None)
    with pytest.raises(InputError, match="apt-get install libegl1 libgl1 libosmesa6"):
        film([shot], tmp_path / "c.png")


# an axis and a robot; `make proof` takes all of them
QUICK = ("pendulum", "arm3")
MODELS = [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in shipped_models()]


@pytest.mark.usefixtures("screen")
@pytest.mark.parametrize("name", MODELS)
def test_a_model_alone_is_moved_by_a_chirp(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mjsim.robot.exciting.ROUNDS", 2)
    out = tmp_path / "model.png"
    result = CliRunner().invoke(command, [str(shipped_model(name)), "--out", str(out), "--size", "320x240"])
    assert result.exit_code == 0, result.exception
    assert out.is_file()


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (["step", "--out", "film.avi"], "mp4, .gif, .png"),
        (["step", "--out", "film.png", "--size", "big"], "WIDTHxHEIGHT"),
        (["step", "--out", "film.png", "--start", "99"], "between 0 and"),
        (["nosuch", "--out", "film.png"], "one of: .*coulomb_1"),
        (["nosuch.xml", "--out", "film.png"], "no such file"),
    ],
)
def test_bad_input(arguments: list[str], match: str) -> None:
    result = CliRunner().invoke(command, arguments)
    assert isinstance(result.exception, InputError)
    import re

    assert re.search(match, str(result.exception))
