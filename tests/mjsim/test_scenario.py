"""Scenarios: every shipped one is valid and runs; logs are reproducible; what cannot run is said in one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mjsim import excitation as ex
from mjsim.errors import InputError
from mjsim.recording import load
from mjsim.scenario import load_scenario, run, shipped_scenarios, write_log
from simgap.commands.run import command

DT = 5e-4


@pytest.mark.parametrize("name", shipped_scenarios())
def test_every_shipped_scenario_runs(name: str) -> None:
    log = run(load_scenario(name, duration_s=5.0 if "multisine" in name else 1.0))
    assert np.all(np.isfinite(log.columns["velocity_rad_s"]))
    assert np.ptp(log.motion.velocity) > 0
    assert shipped_scenarios()[name]


def test_a_log_is_a_recording_and_its_seed_repeats_it(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        path = write_log(run(load_scenario("velocity_loop", duration_s=2.0)), tmp_path / folder)
    assert path.read_bytes() == (tmp_path / "a" / path.name).read_bytes()
    record = load(path)
    assert record.dt == DT
    assert len(record) == 4000
    told = json.loads((tmp_path / "b" / "velocity_loop.provenance.json").read_text())
    assert told["seed"] == 1
    assert len(told["model"]["sha256"]) == 64
    other = run(load_scenario("velocity_loop", duration_s=2.0, seed=2))
    assert not np.array_equal(other.columns["velocity_rad_s"], record.velocity)
    assert not [p for p in (tmp_path / "b").iterdir() if p.name.startswith(".")]


def test_parquet_carries_its_provenance(tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    path = write_log(run(load_scenario("linear", duration_s=0.5, format="parquet")), tmp_path)
    assert json.loads(pq.read_metadata(path).metadata[b"simgap_provenance"])["seed"] == 1
    assert pq.read_table(path).num_rows == 1000


@pytest.mark.parametrize("engine", ["accurate", "literal"])
def test_engines_agree(engine: str) -> None:
    plain, other = (run(load_scenario("linear", duration_s=2.0, engine=e)).motion.velocity for e in ("ode", engine))
    assert np.sqrt(np.mean((plain - other) ** 2) / np.mean(plain**2)) < 1e-5


def test_the_velocity_loop_follows_its_reference() -> None:
    log = run(load_scenario("velocity_loop", duration_s=4.0))
    e = log.scenario.excitation
    wanted = ex.trapezoids(4.0, DT, e.speed, e.acceleration, e.hold_s, e.rest_s)  # type: ignore[union-attr]
    assert np.max(np.abs(wanted)) == 100.0
    assert np.sqrt(np.mean((log.motion.velocity - wanted) ** 2)) < 5.0


def test_multisine_lines() -> None:
    rng = np.random.default_rng(3)
    u = ex.multisine(rng, 10.0, DT, 1.5, 0.5, 45.0, period=5.0, grid=ex.Grid.ODD)
    spectrum = np.abs(np.fft.rfft(u[:10000])) / 5000
    lines = np.flatnonzero(spectrum > 1e-9)
    assert np.all(lines % 2 == 1)
    assert lines[0] == 3
    assert lines[-1] == 225
    np.testing.assert_allclose(spectrum[lines], spectrum[lines[0]], rtol=1e-9)
    assert np.array_equal(u[:10000], u[10000:])
    assert abs(np.sqrt(np.mean(u**2)) - 1.5) < 1e-12


BAD = {
    "effect": ('[[effects]]\nid = "rust"\n', "'rust'.*backlash"),
    "parameter": ('[[effects]]\nid = "backlash"\ngap = 1.0\n', "unknown key 'gap'.*gap_rad"),
    "value": ('[[effects]]\nid = "backlash"\ngap_rad = -1.0\n', "gap_rad = -1"),
    "place": ('[[effects]]\nid = "backlash"\ngap_rad = 1e-4\nplace = "roof"\n', "choose from gearbox, arm"),
    "linear": ("[linear]\nJx = 1.0\n", "Jx.*choose from Jm"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_scenarios_list_the_choices(name: str, tmp_path: Path) -> None:
    text, match = BAD[name]
    path = tmp_path / "mine.toml"
    path.write_text('[excitation]\nkind = "chirp"\namplitude = 1.0\n' + text)
    with pytest.raises(InputError, match=match) as caught:
        run(load_scenario(path))
    assert "\n" not in str(caught.value)


def test_unknown_keys_and_names(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('motel = "x"\n[excitation]\nkind = "chirp"\namplitude = 1.0\n')
    with pytest.raises(InputError, match=r"key 'motel' is not known; expected about, .*; did you mean 'model'"):
        load_scenario(path)
    with pytest.raises(InputError, match=r"one of: .*coulomb_2"):
        load_scenario("coulomb_9")


def test_a_diverging_run_is_stopped_and_named(tmp_path: Path) -> None:
    path = tmp_path / "wild.toml"
    path.write_text('duration_s = 2.0\n[excitation]\nkind = "chirp"\namplitude = 1.0\n[linear]\nfm = -1e3\n')
    result = CliRunner().invoke(command, [str(path), "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, InputError)
    assert "diverged at" in str(result.exception)
    assert not (tmp_path / "out").exists()


def test_list() -> None:
    result = CliRunner().invoke(command, ["--list"])
    assert result.exit_code == 0
    assert all(name in result.output for name in shipped_scenarios())
