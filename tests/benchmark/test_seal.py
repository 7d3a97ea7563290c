"""Cases and their envelope: reproducible, sized, without a hint, and not to be changed unseen."""

from __future__ import annotations

import ast
import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import lab.benchmark
import lab.benchmark.cases
import lab.benchmark.sized
from lab.benchmark.cases import LEVELS, make_case
from lab.benchmark.experiment import Experiment, draw_experiment
from lab.benchmark.laws import Laws
from lab.benchmark.measurement import Measurement
from lab.benchmark.plant import record
from lab.benchmark.refit import LINEAR, refit, rms
from lab.benchmark.seal import envelope_hash, open_envelope, write_cases
from lab.benchmark.sized import SIZE
from mjsim.errors import InputError


def test_the_generator_knows_nothing_of_the_fitting_code() -> None:
    folder = Path(lab.benchmark.__file__).parent
    allowed = {"mjsim.errors"}
    for path in ("laws", "friction", "joints", "solver", "plant", "experiment", "measurement", "catalogue", "refit",
                 "size", "cases", "seal"):  # fmt: skip
        for node in ast.walk(ast.parse((folder / f"{path}.py").read_text())):
            modules = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                modules = [node.module or ""]
            for module in modules:
                assert module.split(".")[0] not in {"mjsim", "ident", "diagnose"} or module in allowed, (path, module)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Recordings of three seconds."""
    for module in (lab.benchmark.cases, lab.benchmark.sized):
        monkeypatch.setattr(module, "draw_experiment", partial(draw_experiment, seconds=3.0))


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize(
    "level",
    [
        "nothing",
        pytest.param("parameters_only", marks=pytest.mark.slow),
        pytest.param("plain", marks=pytest.mark.slow),
        pytest.param("behind_feedback", marks=pytest.mark.slow),
    ],
)
def test_a_case_is_reproducible_and_of_its_level(level: str) -> None:
    a = make_case(level, np.random.default_rng([3, 1]))
    b = make_case(level, np.random.default_rng([3, 1]))
    assert a.truth == b.truth
    assert np.array_equal(a.estimation.velocity, b.estimation.velocity)
    assert np.array_equal(a.held_out.torque, b.held_out.torque)
    for size in a.truth["size"].values():  # type: ignore[attr-defined]
        assert size["distinct"] >= SIZE[level][0]
        assert size["after_refit"] <= SIZE[level][1]
    assert a.truth["closed_loop"] is True or level != "behind_feedback"
    nominal = {n: getattr(Laws(), n) for n in LINEAR}
    assert (a.truth["linear_parameters"] == nominal) == (level == "nothing")


@pytest.mark.slow
@pytest.mark.parametrize("level", LEVELS)
def test_every_level_gives_cases(level: str) -> None:
    for seed in range(3):
        truth = make_case(level, np.random.default_rng([11, seed])).truth
        assert len(truth["effects"]) == {"nothing": 0, "parameters_only": 0, "two_effects": 2}.get(level, 1)  # type: ignore[arg-type]


def test_a_refit_finds_other_linear_parameters() -> None:
    u = draw_experiment("multisine", np.random.default_rng(2), 1.5, 3.0).torque
    other = Laws(Jm=4.8e-4, kg=1.42e5, dg=-58.0, fm=0.037)
    y = record(other, draw_experiment("multisine", np.random.default_rng(2), 1.5, 3.0), Measurement(0.0, 0.0),
               np.random.default_rng(0), substeps=25).velocity_true  # fmt: skip
    found = refit(Laws(), u, y, LINEAR, {})
    assert found.left < 1e-4 * rms(y)
    assert found.laws.kg == pytest.approx(1.42e5, rel=1e-3)


def test_where_friction_holds_the_axis_nothing_is_refitted() -> None:
    u = draw_experiment("multisine", np.random.default_rng(2), 0.5, 1.0).torque
    held = Laws(coulomb_m=0.1 + float(np.max(np.abs(u))))
    y = np.full(len(u), 0.01)
    found = refit(held, u, y, LINEAR, {})
    assert found.laws == held
    assert found.left == pytest.approx(0.01)


def test_noise_has_its_rms_and_colour() -> None:
    rng = np.random.default_rng(1)
    white, angle, drop = Measurement(0.05, 1e-4).noise(20000, rng)
    coloured, _, _ = Measurement(0.05, 1e-4, poles=(0.9 + 0j,)).noise(20000, rng)
    assert rms(white) == pytest.approx(0.05, rel=0.03)
    assert rms(coloured) == pytest.approx(0.05, rel=0.1)
    assert np.corrcoef(coloured[1:], coloured[:-1])[0, 1] == pytest.approx(0.9, abs=0.02)
    assert rms(angle) == pytest.approx(1e-4, rel=0.03)
    assert not drop.any()


def test_noise_reaches_the_torque_only_through_the_loop() -> None:
    rng = np.random.default_rng(1)
    loop = draw_experiment("speed_multisine", rng, 1.0, 1.0)
    a = record(Laws(), loop, Measurement(0.05), np.random.default_rng(1))
    b = record(Laws(), loop, Measurement(0.0), np.random.default_rng(1))
    assert rms(a.torque - b.torque) > 0.5 * loop.kp * 0.05


@pytest.mark.slow
def test_the_envelope(tmp_path: Path) -> None:
    out, truth = tmp_path / "sealed", tmp_path / "truth" / "truth.json"
    counts = {"nothing": 1, "parameters_only": 1}
    digest = write_cases(out, truth, counts, seed=5)
    assert digest == envelope_hash(truth) == json.loads((out / "manifest.json").read_text())["envelope_sha256"]
    names = sorted(p.name for p in out.iterdir())
    assert names == [f"00{n}_{part}.csv" for n in (1, 2) for part in ("estimation", "held_out")] + ["manifest.json"]
    cases = open_envelope(out, truth)
    assert sorted(c["level"] for c in cases.values()) == ["nothing", "parameters_only"]
    table = np.loadtxt(out / "001_estimation.csv", delimiter=",", skiprows=1)
    assert table.shape == (20000, 4)
    assert write_cases(tmp_path / "again", tmp_path / "t2" / "truth.json", counts, seed=5) == digest
    truth.write_text(truth.read_text().replace("nothing", "plain", 1))
    with pytest.raises(InputError, match="changed after it was written"):
        open_envelope(out, truth)


def test_bad_requests_name_the_choices(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="behind_refit"):
        write_cases(tmp_path / "a", tmp_path / "t.json", {"hard": 1}, seed=1)
    with pytest.raises(InputError, match="another folder"):
        write_cases(tmp_path / "a", tmp_path / "a" / "truth.json", {"nothing": 1}, seed=1)


@pytest.mark.usefixtures("short")
def test_the_effect_asked_for_is_concealed() -> None:
    truth = make_case("behind_feedback", np.random.default_rng(3), "torque_ripple").truth
    assert truth["effects"] == ["torque_ripple"]
    with pytest.raises(InputError, match="slipping_clutch"):
        make_case("out_of_library", np.random.default_rng(3), "backlash")


@pytest.mark.parametrize("weak", [1, 2], ids=["estimation", "held out"])
def test_a_recording_that_friction_holds_is_recorded_again(monkeypatch: pytest.MonkeyPatch, weak: int) -> None:
    """With another drive: a recording that stands still shows nothing, and is refused by whoever diagnoses it."""
    draws = []

    def weak_once(kind: str, rng: np.random.Generator, amplitude: float) -> Experiment:
        draws.append(kind)
        return draw_experiment(kind, rng, amplitude * (1e-3 if len(draws) == weak else 1.0), 3.0)

    for module in (lab.benchmark.cases, lab.benchmark.sized):
        monkeypatch.setattr(module, "draw_experiment", weak_once)
    case = make_case("nothing", np.random.default_rng([3, 1]))
    assert len(draws) == 3
    noise = case.truth["measurement"]["velocity_noise"]  # type: ignore[index]
    assert min(rms(case.estimation.velocity_true), rms(case.held_out.velocity_true)) > 3 * noise


def test_the_solver_is_compiled_for_one_kind_of_arguments():
    """Another dtype, another flag of an array, an int for a float: each would be compiled anew, which takes half a minute."""
    from lab.benchmark.laws import Laws
    from lab.benchmark.solver import integrate, run

    zero, wave = np.zeros(50), np.sin(np.arange(50) * 0.1)
    locked = wave.copy()
    locked.flags.writeable = False
    one = run(Laws(), wave, zero, 0.0, 0.0, False, False, zero, zero, np.zeros(50, np.int8), 2000.0, 20)
    two = run(Laws(coulomb_m=0), locked, zero, 0, 0, np.bool_(False), False, zero, zero, np.zeros(50, bool), 2000, 20)
    assert len(integrate.signatures) == 1
    np.testing.assert_array_equal(one[1], two[1])
