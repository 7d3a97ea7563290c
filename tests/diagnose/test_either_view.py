"""A log of torque and angle: compared by force, and by motion where a free run of the answer follows it."""

from __future__ import annotations

import dataclasses
import json
import math
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.options import Options
from diagnose.pipeline import diagnose
from diagnose.result import Verdict
from diagnose.thresholds import FAR, MATERIAL, MOST
from mjsim.axis import Axis, Body, Chain
from mjsim.effects import effect_class
from mjsim.errors import InputError
from mjsim.mjcf import load_axis
from mjsim.ode import simulate
from mjsim.recording import Recording
from mjsim.system import assemble
from simgap import either_view
from simgap.either_view import _follows_freely, _is_open, by_force_too, by_motion_too
from simgap.pipeline import diagnose_files

MODEL = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody><body name="rotor">
  <joint name="hinge" axis="0 0 1" damping="0.4"/><inertial pos="0 0 0" mass="1" diaginertia=".07 .07 .07"/></body></worldbody>
  <actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""
NOMINAL = Axis(Chain((Body("motor", 0.07, 0.4, "hinge"),), ()))
COULOMB = effect_class("coulomb_friction")(torque_Nm=0.4)
ONLY = ("coulomb_friction", "torque_offset")
DT = 2e-3


@cache
def log(seed, disturbance=0.0):
    """Torque and angle of a rotor with Coulomb friction; ``disturbance``: rms of a slow torque that is not in the log."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(4000)
    u = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in (0.3, 1.1, 4.0))
    unknown = np.cumsum(rng.standard_normal(len(t)))
    unknown *= disturbance / np.std(unknown)
    run = simulate(assemble(NOMINAL + COULOMB), u + unknown, DT)
    return Recording(t, u, None, run.angle + 2e-5 * rng.standard_normal(len(t)), DT, source=f"log_{seed}.csv")


@cache
def by_force(disturbance):
    return diagnose(NOMINAL, [log(1, disturbance)], [log(2, disturbance)], Options(jobs=1, judge="force", effects=ONLY))


@pytest.mark.parametrize(("disturbance", "follows"), [(0.0, True), pytest.param(0.3, False, marks=pytest.mark.slow)])
def test_a_free_run_follows_where_no_unknown_torque_makes_it_drift(disturbance, follows):
    pair = [log(1, disturbance), log(2, disturbance)]
    assert _follows_freely(NOMINAL, by_force(disturbance), pair[:1], pair[1:], Options(jobs=1)) is follows


def test_what_was_asked_for_is_not_changed():
    pair, result = [log(1, 0.0), log(2, 0.0)], by_force(0.0)
    assert _is_open(result, pair[0], Options())
    assert not _is_open(result, pair[0], Options(judge="force"))
    assert not _is_open(result, dataclasses.replace(pair[0], judge="force"), Options())
    assert not _is_open(result, dataclasses.replace(pair[0], velocity=np.gradient(pair[0].angle, DT)), Options())
    assert not _is_open(dataclasses.replace(result, channel="velocity"), pair[0], Options())


@pytest.mark.slow
def test_motion_decides_where_it_explains_the_recordings(tmp_path):
    model = tmp_path / "rotor.xml"
    model.write_text(MODEL, encoding="utf-8")
    assert load_axis(model).chain.bodies[0].inertia == pytest.approx(0.07)
    files = []
    for r in (log(1), log(2)):
        files.append(tmp_path / r.source)
        np.savetxt(
            files[-1],
            np.column_stack([r.time, r.torque, r.angle]),
            delimiter=",",
            header="time_s,torque_Nm,angle_rad",
            comments="",
        )
    diagnose_files(files[:1], model, tmp_path / "out", files[1:], Options(jobs=1, effects=ONLY), progress=False, page=False)
    said = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert said["verdict"] == "missing_physics"
    assert said["judged_on"]["channel"] == "velocity"
    (found,) = (f for f in said["findings"] if f["class"] == "physics")
    assert found["effect"] == "coulomb_friction"
    low, high = found["parameters"]["torque_Nm"]["ci95"]
    assert low < 0.4 < high
    assert high - low < 0.01
    assert any("compared by force first" in note.lower() for note in said["notes"])


@pytest.fixture
def motion(monkeypatch):
    """`by_motion_too` around made-up steps: ``motion(open, follows, second, given, seconds)`` and the options it passed on."""
    passed = []

    def ask(
        is_open=True,
        follows=True,
        second=Verdict.MISSING_PHYSICS,
        given="given",
        seconds=math.inf,
        takes=0.0,
        named=True,
        takes_most=None,
    ):
        clock = iter([100.0, 100.0 + takes])
        monkeypatch.setattr(either_view.time, "monotonic", lambda: next(clock))
        monkeypatch.setattr(either_view, "_is_open", lambda *_: is_open)
        monkeypatch.setattr(either_view, "_follows_freely", lambda *_: follows)

        def before(model, nominal, recordings, held_out, options):
            passed.append(options)
            return given

        monkeypatch.setattr(either_view, "before_search", before)
        left = SimpleNamespace(held_out_rms=0.0 if takes_most else 1.0)
        fit = {"refitted": SimpleNamespace(held_out_rms=1.0), "corrected": left}
        found = dataclasses.replace(by, verdict=second, findings=() if takes_most is None else ("one",), fit=fit)
        monkeypatch.setattr(either_view, "by_either_numerics", lambda *_: ("axis", "runs", found))
        first = by if named else dataclasses.replace(by, findings=())
        out = by_motion_too("m.xml", NOMINAL, first, ["log"], [], Options(seconds=seconds), lambda _: None)
        return out, passed

    @dataclasses.dataclass(frozen=True)
    class Found:
        verdict: Verdict = Verdict.UNEXPLAINED
        notes: tuple[str, ...] = ("kept",)
        findings: tuple[str, ...] = ("one",)
        fit: object = None

    by = Found()
    return ask


def test_motion_counts_where_it_is_asked_for_and_explains(motion):
    (axis, runs, second), passed = motion(seconds=50.0, takes=20.0)
    assert (axis, runs, second.verdict) == ("axis", "runs", Verdict.MISSING_PHYSICS)
    assert second.notes[0] == either_view.BY_MOTION
    assert second.notes[1:] == ("kept",)
    assert passed[0].judge == "motion"
    assert passed[0].seconds == 30.0


def test_motion_has_the_time_that_is_left(motion):
    (axis, _, _), passed = motion(seconds=20.5, takes=20.0)
    assert axis == "axis"
    assert passed[0].seconds == 0.5


@pytest.mark.parametrize(
    "what",
    [
        {"is_open": False},
        {"follows": False},
        {"second": Verdict.UNEXPLAINED},
        {"given": None},
        {"seconds": 20.0, "takes": 20.0},
        {"seconds": 19.0, "takes": 20.0},
    ],
)
def test_force_decides_where_motion_cannot(motion, what):
    (axis, runs, first), _ = motion(**what)
    assert axis is NOMINAL
    assert runs is None
    assert first.verdict is Verdict.UNEXPLAINED


@pytest.mark.parametrize(("takes_most", "decides"), [(True, True), (False, False), (None, False)])
def test_motion_names_what_takes_most_where_force_names_nothing(motion, takes_most, decides):
    """Though a free run of it does not follow, and much is left."""
    (axis, _, _), _ = motion(named=False, follows=False, second=Verdict.UNEXPLAINED, takes_most=takes_most)
    assert (axis == "axis") is decides
    (axis, _, _), passed = motion(named=True, follows=False, second=Verdict.UNEXPLAINED, takes_most=True)
    assert axis is NOMINAL
    assert len(passed) == 1, "it is not asked where force names something that does not follow"


PLAIN = Recording(DT * np.arange(9), np.arange(9.0), None, np.arange(9.0), DT)


@pytest.mark.parametrize(
    ("ok", "above", "nrmse", "follows"),
    [(True, False, None, True), (True, True, None, False), (False, False, 0.0, False),
     (True, True, 0.99 * MATERIAL**0.5, True), (True, True, 1.01 * MATERIAL**0.5, False)],
)  # fmt: skip
def test_a_free_run_follows_up_to_a_level(monkeypatch, ok, above, nrmse, follows):
    """The fit is solved and not above `FAR`, or errs by little of the motion; the workers are released in any case."""
    closed, levels = [], []

    class Fitted:
        def __init__(self, *_):
            pass

        def hypothesis(self, *_):
            return None

        def fit(self, _):
            return SimpleNamespace(ok=ok)

        def above(self, fitted, level):
            levels.append(level)
            return above

        def validate(self, fitted):
            return None if nrmse is None else SimpleNamespace(nrmse=nrmse)

        def close(self):
            closed.append(True)

    monkeypatch.setattr(either_view, "split", lambda *_: ((), ()))
    monkeypatch.setattr(either_view, "Fitter", Fitted)
    monkeypatch.setattr(either_view, "physics_found", lambda _: [])
    monkeypatch.setattr(either_view, "as_fitted", lambda _: {})
    assert _follows_freely(NOMINAL, None, [PLAIN], [PLAIN], Options(jobs=1)) is follows
    assert closed == [True]
    assert levels in ([], [FAR])

    def refuse(*_):
        raise InputError("log", "what", "more")

    monkeypatch.setattr(either_view, "Fitter", refuse)
    assert _follows_freely(NOMINAL, None, [PLAIN], [PLAIN], Options(jobs=1)) is False


@pytest.mark.parametrize(
    ("changed", "is_open"),
    [({}, True), ({"channel": "velocity"}, False), ({"asked": "force"}, False), ({"bound": "force"}, False),
     ({"velocity": np.zeros(3)}, False), ({"angle": None}, False)],
)  # fmt: skip
def test_who_chooses_the_comparison(changed, is_open):
    first = SimpleNamespace(judge=changed.get("bound"), velocity=changed.get("velocity"), angle=changed.get("angle", np.zeros(3)))
    assert (
        _is_open(SimpleNamespace(channel=changed.get("channel", "torque")), first, Options(judge=changed.get("asked"))) is is_open
    )


class Free:
    """A diagnosis by motion that stays unexplained, and one by force, around made-up steps."""

    def __init__(self, monkeypatch, *, findings=(), after=1.0, quiet=False, found=("friction",), refuse=False, given=1.0):
        self.asked = []
        fit = {"refitted": SimpleNamespace(held_out_rms=1.0), "corrected": SimpleNamespace(held_out_rms=after)}
        self.first = SimpleNamespace(verdict=Verdict.UNEXPLAINED, findings=findings, fit=fit)

        def by_force(nominal, recordings, held_out, options, say):
            self.asked.append(options)
            if refuse:
                raise InputError("log", "few samples", "more", "record")
            return self.second

        monkeypatch.setattr(either_view, "diagnose", by_force)
        monkeypatch.setattr(either_view, "at_noise", lambda *_, angles: quiet)
        monkeypatch.setattr(either_view, "summary", lambda verdict, *_: verdict)
        corrected = SimpleNamespace(held_out_rms=0.99)
        self.second = Second(found, fit={"nominal": SimpleNamespace(held_out_rms=given), "corrected": corrected})

    def ask(self, options=None, nominal=NOMINAL, judge=None):
        given = SimpleNamespace(cases=(), runs=())
        logs = [SimpleNamespace(judge=judge)]
        return by_force_too(nominal, self.first, given, logs, [], options or Options(), lambda _: None)


@dataclasses.dataclass(frozen=True)
class Second:
    findings: tuple[str, ...]
    verdict: Verdict = Verdict.MISSING_PHYSICS
    summary: object = None
    fit: object = None
    gap_closed: float = 0.5
    unit: str = "N m"
    notes: tuple[str, ...] = ("kept",)


MOST_TAKEN = math.sqrt(1.0 - MOST)


@pytest.mark.parametrize(("findings", "after"), [((), 1.0), (("inertia",), 1.001 * MOST_TAKEN)])
def test_force_names_what_a_free_run_does_not_and_the_verdict_stays(monkeypatch, findings, after):
    free = Free(monkeypatch, findings=findings, after=after)
    said = free.ask(Options(seconds=50.0))
    assert (said.findings, said.verdict, said.summary) == (("friction",), Verdict.UNEXPLAINED, Verdict.UNEXPLAINED)
    assert said.notes == (either_view.BY_FORCE, "kept")
    assert (free.asked[0].judge, free.asked[0].seconds) == ("force", 50.0)


@pytest.mark.parametrize(
    ("made", "asked"),
    [({"findings": ("inertia",), "after": 0.999 * MOST_TAKEN}, {}), ({"quiet": True}, {}), ({"found": ()}, {}),
     ({"given": 0.99}, {}), ({"refuse": True}, {}), ({}, {"options": Options(judge="motion")}), ({}, {"judge": "motion"}),
     ({}, {"options": Options(seconds=0.0)}), ({}, {"nominal": SimpleNamespace(chain=SimpleNamespace(servo="law"))})],
)  # fmt: skip
def test_the_free_run_counts_where_force_is_not_asked_for_or_finds_nothing(monkeypatch, made, asked):
    free = Free(monkeypatch, **made)
    assert free.ask(**asked) is free.first


def test_an_answer_by_motion_is_not_asked_again(monkeypatch):
    free = Free(monkeypatch)
    free.first.verdict = Verdict.MISSING_PHYSICS
    assert free.ask() is free.first
    assert not free.asked


@pytest.mark.slow
def test_friction_is_named_beside_a_slow_unknown_torque(tmp_path):
    """A free run adds the unknown torque up; by force each sample counts for itself."""
    model, files = tmp_path / "rotor.xml", []
    model.write_text(MODEL, encoding="utf-8")
    for seed in (1, 2):
        r = log(seed, 0.3)
        velocity = np.gradient(r.angle, DT) + 0.01 * np.random.default_rng(seed).standard_normal(len(r.time))
        files.append(tmp_path / r.source)
        table = np.column_stack([r.time, r.torque, velocity, r.angle])
        np.savetxt(files[-1], table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s,angle_rad", comments="")
    options = Options(jobs=1, effects=("coulomb_friction",))
    diagnose_files(files[:1], model, tmp_path / "out", files[1:], options, progress=False, page=False, accept_log=True)
    said = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert said["verdict"] == "unexplained"
    (found,) = said["findings"]
    assert found["effect"] == "coulomb_friction"
    assert 0.2 < found["parameters"]["torque_Nm"]["value"] < 0.6
    assert said["judged_on"]["channel"] == "torque"
    assert either_view.BY_FORCE in said["notes"]
