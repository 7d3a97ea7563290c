"""Friction of each recording by itself, its trend over time, and how well the data determine a fit."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.data.stretches import Stretch, Stretches
from diagnose.evidence.conditioning import conditioning
from diagnose.fit.fitter import Fitter
from diagnose.problem.view import MotionView
from diagnose.result import Estimate
from diagnose.verdict.friction_over_time import friction_by_recording, trends
from mjsim.effects import effect_class
from mjsim.errors import InputError
from mjsim.recording import Recording, load
from simgap.long_logs import TOGETHER, told, trend_sentences

COULOMB = effect_class("coulomb_friction")


def estimate(value, half=0.01):
    return Estimate(value, (value - half, value + half), "N m")


def test_each_recording_has_its_own_friction(robot, record):
    """Two recordings of different friction, fitted together and then one by one."""
    levels = (0.05, 0.08)
    recordings = [
        dataclasses.replace(record(COULOMB(torque_Nm=level), seed=seed), sha256=str(seed)) for seed, level in enumerate(levels)
    ]
    fitter = Fitter(robot, MotionView(), tuple(prepare(r) for r in recordings), (), 1)
    best = fitter.fit(fitter.hypothesis([COULOMB(torque_Nm=0.06)]))
    together = best.effects[0].torque_Nm
    found = friction_by_recording(fitter, best)
    fitter.close()
    assert levels[0] < together < levels[1]
    (name,) = {n for numbers in found.values() for n in numbers if n.startswith("coulomb_friction")}
    for seed, level in enumerate(levels):
        low, high = found[str(seed)][name].ci95
        assert high > low
        assert abs(found[str(seed)][name].value - level) < 0.2 * (levels[1] - levels[0])
    assert best.effects[0].torque_Nm == together
    found = conditioning(best)
    assert (found.rank, found.undetermined) == (found.numbers, ())
    assert 1 < found.condition < 1e6


def test_what_the_data_do_not_depend_on_is_said(robot, record):
    fitter = Fitter(robot, MotionView(), (prepare(record()),), (), 1)
    best = fitter.fit(fitter.hypothesis(()), iterations=1)
    fitter.close()
    residual, J = best.fit.linear.arrays
    J = J.copy()
    J[: len(residual) - best.hypothesis.prior_terms[0], 0] = 0.0
    linear = type(best.fit.linear).known(residual, J)
    found = conditioning(dataclasses.replace(best, fit=dataclasses.replace(best.fit, linear=linear)))
    assert found.rank == found.numbers - 1
    assert found.undetermined == (best.hypothesis.entries[0].label,)
    assert found.condition == np.inf


def test_a_trend_is_found_where_it_is():
    times = [0.0, 600.0, 1200.0, 1800.0, 2400.0]
    falling = [{"f": estimate(1 - t / 3600 + d)} for t, d in zip(times, (0.002, -0.003, 0.001, 0.002, -0.002), strict=True)]
    (line,) = trends(times, falling)
    assert line.significant
    assert line.ci95[0] < -1 / 3600 < line.ci95[1] < 0
    assert (line.first, line.last) == pytest.approx((1.0, 1 - 2400 / 3600), abs=0.01)
    assert "an hour" in line.sentence()


def test_scatter_beyond_the_intervals_is_no_trend():
    times = list(range(5))
    scattered = [{"f": estimate(v)} for v in (1.0, 1.3, 0.8, 1.25, 1.1)]
    (line,) = trends(times, scattered)
    assert not line.significant
    assert line.ci95[0] < 0 < line.ci95[1]


@pytest.mark.parametrize(("count", "lines"), [(3, 0), (4, 1)])
def test_a_line_needs_four_recordings(count, lines):
    assert len(trends(range(count), [{"f": estimate(1 + 0.1 * i)} for i in range(count)])) == lines


def test_a_number_without_an_interval_is_left_out():
    numbers = [{"f": estimate(1.0, np.inf)}, *({"f": estimate(1.0)} for _ in range(3))]
    assert trends(range(4), numbers) == ()


def test_many_numbers_are_tested_together():
    """A p-value that is enough for one number is not for forty."""
    times = list(range(6))
    steep = [{"f": estimate(1 + 0.03 * t + d)} for t, d in zip(times, (0.02, -0.02, 0.0, 0.02, -0.02, 0.0), strict=True)]
    (alone,) = trends(times, steep)
    assert 0.01 / 40 < alone.p_value <= 0.01
    assert alone.significant
    flat = {f"g{i}": estimate(1.0) for i in range(39)}
    together = trends(times, [numbers | flat for numbers in steep])
    assert not any(line.significant for line in together)


def stretches(temperatures, times=None):
    """Stretches of one log, with their mean temperatures, and Coulomb friction that follows `level` of them."""
    n = len(temperatures)
    times = np.linspace(0.0, 3600.0, n) if times is None else times
    recordings = [
        Recording(np.arange(3.0), np.zeros(3), np.zeros(3), None, 1.0, sha256=str(i),
                  temperature=None if c is None else np.array([c - 1.0, c, c + 1.0]))
        for i, c in enumerate(temperatures)
    ]  # fmt: skip
    chosen = [Stretch("log.csv", i, i + 1, float(t), float(t) + 1.0, 1.0, False) for i, t in enumerate(times)]
    return Stretches(tuple(chosen), tuple(recordings), n, 0)


def test_friction_over_temperature_is_told_beside_that_over_time():
    """Friction that falls with a temperature that goes up and down: a line over temperature, none over time."""
    degrees = [20.0, 60.0, 30.0, 50.0, 60.0, 20.0, 50.0, 30.0]
    part = stretches(degrees)
    friction = {str(i): {"coulomb": estimate(0.5 - 0.005 * c, 0.002)} for i, c in enumerate(degrees)}
    (said,) = trend_sentences([part], friction)
    assert said.startswith(
        "log.csv: coulomb changes with the temperature: 0.4 N m at 20 degC, 0.2 N m at 60 degC, -0.005 N m per"
    )
    assert [s["temperature_degC"] for s in told([part], friction)] == degrees
    steady = {str(i): {"coulomb": estimate(0.3)} for i in range(8)}
    assert trend_sentences([part], steady) == []


@pytest.mark.parametrize(("odd", "together"), [(0.0, True), (60.0, False)])
def test_time_and_temperature_that_rise_together_are_not_told_apart(odd, together):
    degrees = [20.0 + 5.0 * i + odd * (i == 1) for i in range(8)]
    part = stretches(degrees)
    friction = {str(i): {"coulomb": estimate(0.5 - 0.003 * c, 0.002)} for i, c in enumerate(degrees)}
    said = trend_sentences([part], friction)
    assert any("with the temperature" in s for s in said)
    assert any(TOGETHER in s for s in said) is together


def test_a_log_without_a_temperature_says_nothing_of_it():
    part = stretches([None] * 8)
    friction = {str(i): {"coulomb": estimate(0.5 - 0.01 * i, 0.002)} for i in range(8)}
    (said,) = trend_sentences([part], friction)
    assert "over the recording" in said
    assert all("temperature_degC" not in s for s in told([part], friction))


@pytest.mark.parametrize("unit", ["", ', unit = "degC"', ', unit = "°C"'])
def test_a_temperature_is_bound(tmp_path, unit):
    rows = "".join(f"{0.01 * i:.2f},{i % 7},{i % 5},{30 + i}\n" for i in range(9))
    (tmp_path / "log.csv").write_text("time_s,torque_Nm,velocity_rad_s,housing\n" + rows)
    (tmp_path / "log.toml").write_text(f'[recording]\ntemperature = {{column = "housing"{unit}}}\n', encoding="utf-8")
    assert np.array_equal(load(tmp_path / "log.csv").temperature, 30.0 + np.arange(9))
    (tmp_path / "log.toml").write_text('[recording]\ntemperature = {column = "housing", unit = "rpm"}\n')
    with pytest.raises(InputError, match="a unit of temperature"):
        load(tmp_path / "log.csv")
