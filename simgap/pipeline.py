"""From files to a folder with a diagnosis: diagnosis.json, corrected.xml, report.html, and mapped.xml where a map is given."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from diagnose.check import LogCheck, LogVerdict
from diagnose.check.answer import wrong_log
from diagnose.data.channels import with_common_channels
from diagnose.data.content import at_content_rate
from diagnose.data.derived import without_derived_velocity
from diagnose.data.gap_input import with_input_in_gaps
from diagnose.data.servo import as_servo
from diagnose.data.split import split
from diagnose.data.stretches import Stretches
from diagnose.fit.command_hold import WORDS, with_hold
from diagnose.fit.ledger import Ledger, fingerprint
from diagnose.pipeline import Options, diagnose
from diagnose.progress import Step
from diagnose.result import Diagnosis
from diagnose.robot.check.faults import WRONG
from diagnose.verdict.notes import DERIVED
from diagnose.verdict.reference_stage import Nominal
from mjsim.axis import Axis
from mjsim.compiled import kept_at
from mjsim.control import as_driven
from mjsim.errors import InputError
from mjsim.kernel import integrate
from mjsim.mjcf import check_writable, load_axis, write_corrected
from mjsim.mjcf.assets import bring_assets, placed
from mjsim.mjcf.whole import WRITTEN, is_whole, write_whole
from mjsim.mjcf.xmltext import decoded
from mjsim.notices import quiet
from mjsim.ode import DivergedError, load_kernel
from mjsim.recording import Recording
from mjsim.system import UNROLLED
from simgap.either_numerics import by_either_numerics, open_beyond
from simgap.either_view import by_force_too, by_motion_too
from simgap.following import following
from simgap.found import corrected_axis
from simgap.judging import before_search, write_judged
from simgap.long_logs import load_all, told, trend_sentences
from simgap.servo_log import another_hold, checked_servo, hold_beside, later_hold, with_taken
from simgap.torque_log import checked_torque

__all__ = ["corrected_axis", "diagnose_files", "diagnose_recordings", "mapped_axis", "model_diff"]

STATE = "state.jsonl"  # in the folder while a diagnosis runs, and after one that was broken off
IN_ONE_FILE = (
    f"{{given}} includes other files, or has elements without a name. {WRITTEN} is the same model in one file with names; "
    "corrected.xml is a copy of it."
)
MAP_COMMENT = "This file holds a torque map: fitted, not derived. It predicts better and explains nothing."


def mapped_axis(nominal: Axis, diagnosis: Diagnosis) -> Axis | None:
    """The nominal axis with the torque map and what was fitted beside it; None when no map is given."""
    found = diagnosis.map
    if found is None:
        return None
    return nominal.with_values(found.linear).with_effects((*found.effects, found.effect))


def model_diff(model: Path, corrected: Path) -> str:
    """What the corrected file changes of the nominal one, as a unified diff."""
    before, after = (decoded(p.read_bytes())[0].splitlines(keepends=True) for p in (model, corrected))
    return "".join(difflib.unified_diff(before, after, model.name, corrected.name, n=1))


def diagnose_files(
    recordings: Sequence[Path],
    model: Path,
    out: Path,
    held_out: Sequence[Path] = (),
    options: Options | None = None,
    *,
    progress: bool | None = True,
    truth: Mapping[str, Any] | None = None,
    page: bool = True,
    accept_log: bool = False,
    joint: str | None = None,
) -> Diagnosis:
    """Diagnose files and write the folder ``out``; nothing stands there under its final name before it is whole.

    The log is checked first. Where it has to be fixed, that is the answer and nothing is searched, unless ``accept_log``; of a
    servo's log such faults are a wrong sign, unit or gear. ``joint``: which one of a robot's log, by default the one that the
    model drives. ``page``: whether report.html is written too.

    Broken off (KeyboardInterrupt), it leaves what it has fitted in ``out / STATE``: the same call goes on from there and comes to
    the same end. The file goes when the folder is written.
    """
    options = options or Options()
    _need_folder(out)
    chain = load_axis(model).chain
    read = load_all(recordings, held_out, model, joint, chain.bodies[0].joint, driven=chain.driven)
    return diagnose_recordings(
        read.fitted,
        model,
        out,
        read.held_out,
        options,
        progress=progress,
        truth=truth,
        page=page,
        accept_log=accept_log,
        stretches=read.stretches,
    )


def diagnose_recordings(
    recordings: Sequence[Recording],
    model: Path,
    out: Path,
    held_out: Sequence[Recording] = (),
    options: Options | None = None,
    *,
    progress: bool | None = True,
    truth: Mapping[str, Any] | None = None,
    page: bool = True,
    accept_log: bool = False,
    stretches: Sequence[Stretches] = (),
) -> Diagnosis:
    """As `diagnose_files`, of recordings that are loaded; the report is written where ``page`` says so.

    ``stretches``: of which long recordings those are parts.
    """
    began, options = time.monotonic(), options or Options()
    options = dataclasses.replace(options, by_recording=bool(stretches))
    said = [part.sentence() for part in stretches]
    if not is_whole(model):
        said.append(IN_ONE_FILE.format(given=model.name))
        model = write_whole(model, out / WRITTEN)
        bring_assets(model)
    nominal = load_axis(model)
    check_writable(model, nominal)
    for name in options.effects:
        _need_place(name, nominal, model)
    recordings, held_out = ([as_driven(nominal.chain, r) for r in group] for group in (recordings, held_out))
    recordings, held_out, alike = with_common_channels(recordings, held_out)
    recordings, held_out, filled = with_input_in_gaps(recordings, held_out)
    split(*_usable(nominal, recordings, held_out))  # one line for what cannot be used at all, before anything is told
    if nominal.chain.servo is not None:
        log, recordings, held_out = checked_servo(model, nominal, recordings, held_out, options.since(began).seconds)
    else:
        log, recordings, held_out = checked_torque(model, nominal, recordings, held_out, options.since(began), accept=accept_log)
    if log is not None and _has_to_be_fixed(log, nominal) and not accept_log:
        return _written(wrong_log(nominal, log, recordings, held_out, options.seed), nominal, model, out, truth, page)
    if nominal.chain.servo is not None and log is not None:
        said += [f"The log, to be fixed: {p.sentence} {p.advice}." for p in log.to_fix()]
    recordings, held_out, derived = _measured_alone(nominal, recordings, held_out)
    recordings, held_out, slower = _at_content_rate(recordings, held_out, options)
    said += [*alike, *filled, *derived, *slower]
    ledger = Ledger(out / STATE, _follows(nominal, recordings, held_out, options, model.read_bytes()))
    with following(progress, ledger.recalled) as say:
        nominal, given, result = _searched(model, nominal, recordings, held_out, options.since(began), say, ledger)
        hold = hold_beside(result, nominal, recordings, held_out, options.since(began), say, open_beyond(given))
        while hold != recordings[0].hold and options.since(began).seconds > 0:
            say(Step("search", f"again, since the command {WORDS[hold]}"))
            recordings, held_out, log = with_hold(recordings, hold), with_hold(held_out, hold), with_taken(log, hold, recordings)
            nominal, given, result = _searched(model, nominal, recordings, held_out, options.since(began), say, None)
            hold = later_hold(result, [*recordings, *held_out])
        result = dataclasses.replace(
            result,
            log=log,
            notes=(*said, *trend_sentences(stretches, result.friction), *result.notes),
            stretches=told(stretches, result.friction),
        )
        say(Step("write", "corrected.xml stepped by plain MuJoCo, report"))
        result = _written(result, nominal, model, out, truth, page, given, options.jobs, began)
    ledger.discard()
    return result


def _searched(
    model: Path, nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options,
    say: Callable[[Step], None], ledger: Ledger | None,
) -> tuple[Axis, Nominal | None, Diagnosis]:  # fmt: skip
    """The nominal axis and its file in plain MuJoCo, both as the search compared with them, and what it found.

    Raises InputError for a nominal model whose simulation diverges.
    """
    began = time.monotonic()
    try:
        with _compiling_told(say):
            by_motion = recordings[0].velocity is not None or recordings[0].command is not None
            if "force" not in (options.judge, recordings[0].judge) and by_motion and options.jobs > 1:
                _load_kernels(len(nominal.chain.bodies))
            say(Step("reference", "the nominal file in plain MuJoCo"))
            given = before_search(model, nominal, recordings, held_out, options)
            if given is not None:
                stale = another_hold(nominal, recordings, held_out, options.since(began))
                axis, runs, result = by_either_numerics(given, recordings, held_out, options.since(began), say, ledger, stale)
                return axis, runs, by_force_too(nominal, result, runs, recordings, held_out, options.since(began), say)
            result = diagnose(nominal, recordings, held_out, options.since(began), say, ledger)
            return by_motion_too(model, nominal, result, recordings, held_out, options.since(began), say)
    except InputError:
        if ledger is not None:
            ledger.discard()
        raise
    except DivergedError as error:  # of the model as given: one that is tried and diverges is rejected where it is tried
        if ledger is not None:
            ledger.discard()
        raise InputError(model, f"its simulation diverges: {error}", "finite numbers", "check inertias and stiffnesses") from None
    finally:
        if ledger is not None:
            ledger.close()


def _has_to_be_fixed(log: LogCheck, nominal: Axis) -> bool:
    """Whether a fault of the log makes every number wrong; a servo may be late or weak as the check of its log says."""
    if nominal.chain.servo is None:
        return log.verdict is LogVerdict.FIX
    return any(p.problem in WRONG for p in log.to_fix())


def _measured_alone(
    nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording]
) -> tuple[Sequence[Recording], Sequence[Recording], tuple[str, ...]]:
    """Recordings without a velocity that all of them made of their angle, and a sentence that says so."""
    if nominal.chain.servo is not None or recordings[0].velocity is None:
        return recordings, held_out, ()
    fitted, held = ([without_derived_velocity(r) for r in group] for group in (recordings, held_out))
    if any(r.velocity is not None for r in (*fitted, *held)):
        return recordings, held_out, ()
    return fitted, held, (DERIVED,)


def _at_content_rate(
    recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options
) -> tuple[list[Recording], list[Recording], tuple[str, ...]]:
    """Filtered recordings that are judged by motion at the rate that their content needs, and a sentence that says so."""
    first = recordings[0]
    if first.command is None and ("force" in (options.judge, first.judge) or first.velocity is None):
        return list(recordings), list(held_out), ()
    slower, said = at_content_rate([*recordings, *held_out])
    return slower[: len(recordings)], slower[len(recordings) :], said


def _usable(
    nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording]
) -> tuple[list[Recording], list[Recording]]:
    """The recordings as they are fitted; raises InputError for a log without the channels that the model's drive needs."""
    _, fitted, held, _ = as_servo(nominal, recordings, held_out)
    return [without_derived_velocity(r) for r in fitted], [without_derived_velocity(r) for r in held]


def _written(
    result: Diagnosis, nominal: Axis, model: Path, out: Path, truth: Mapping[str, Any] | None, page: bool,
    given: Nominal | None = None, threads: int = 1, began: float | None = None,
) -> Diagnosis:  # fmt: skip
    """Write the folder of a diagnosis, judged by plain MuJoCo where ``given`` says what the nominal file does there.

    ``began``: when the diagnosis did, by the monotonic clock; its seconds are those up to the page.
    """
    out.mkdir(parents=True, exist_ok=True)
    corrected = out / "corrected.xml"
    with placed(corrected) as part:
        result = write_judged(model, nominal, corrected_axis(nominal, result), result, given, part, threads)
    mapped, with_map = out / "mapped.xml", mapped_axis(nominal, result)
    if with_map is None:
        mapped.unlink(missing_ok=True)
    else:
        with placed(mapped) as part:
            write_corrected(model, with_map, part, MAP_COMMENT)
    if began is not None:
        result = dataclasses.replace(result, seconds=time.monotonic() - began)
    if page:
        from diagnose.report import write_report

        write_report(result, out / "report.html", corrected_diff=model_diff(model, corrected), truth=truth)
    result.write_json(out / "diagnosis.json")
    return result


@contextmanager
def _compiling_told(say: Callable[[Step], None]) -> Iterator[None]:
    """Say so when the simulation has to be compiled, and how far: the first diagnosis on a machine waits for it."""

    def tell(done: int) -> None:
        so_far = f": {done} functions so far" if done else ""
        say(Step("compile", f"the simulation of this kind of axis, once on a machine, takes one to three minutes{so_far}"))

    with quiet(), _when_compiling(lambda: tell(0), tell):
        yield


@contextmanager
def _when_compiling(begin: Callable[[], None], ended: Callable[[int], None] = lambda done: None) -> Iterator[None]:
    """Call ``begin`` once, when something begins to be compiled, and ``ended`` with how many functions are."""
    from numba.core import event

    class Told(event.Listener):
        begun, done = False, 0

        def on_start(self, event: Any) -> None:
            if not self.begun:
                self.begun = True
                begin()

        def on_end(self, event: Any) -> None:
            self.done += 1
            ended(self.done)

    with event.install_listener("numba:compile", Told()):
        yield


_COMPILE = f"import sys; sys.path[:] = sys.argv[2:]; from {load_kernel.__module__} import load_kernel as k; k(int(sys.argv[1]))"


def _load_kernels(bodies: int) -> None:
    """Load the simulation of an axis; where it must be compiled, that of one with a further mode is, by a process beside it.

    Chains of more than `UNROLLED` bodies share their code with those of a further mode.
    """
    beside: list[subprocess.Popen[bytes]] = []

    def begin() -> None:
        if bodies <= UNROLLED and sys.executable and not getattr(sys, "frozen", False) and kept_at(integrate) is not None:
            with contextlib.suppress(OSError):  # no process can be had
                beside.append(
                    subprocess.Popen([sys.executable, "-c", _COMPILE, str(bodies + 1), *sys.path], stderr=subprocess.DEVNULL)
                )

    try:
        with _when_compiling(begin):
            load_kernel(bodies)
        for process in beside:
            process.wait()  # else both would compile it
    finally:
        for process in beside:
            process.kill()
            process.wait()


def _follows(
    nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options, model: bytes = b""
) -> str:
    """Hash of what the fits of a diagnosis follow from (of ``model``, its options); neither threads nor a budget change a fit."""
    same = dataclasses.replace(options, jobs=1, seconds=math.inf, effort=1.0)
    return fingerprint(nominal, (*recordings, *held_out), len(recordings), same, model)


def _need_folder(out: Path) -> None:
    """Refuse, before the work is done, a place at which no folder can be made. Raises InputError."""
    there = next(p for p in (out, *out.resolve().parents) if p.exists())
    if not there.is_dir():
        raise InputError(out, f"{there.name!r} is a file", "a folder", "choose another --out")
    if not os.access(there, os.W_OK):
        raise InputError(out, "the folder cannot be written", "a writable place", "choose another --out")


def _need_place(name: str, axis: Axis, model: Path) -> None:
    """Refuse an effect that was asked for and that this chain cannot have. Raises InputError."""
    from mjsim.effects import NotApplicableError, effect_class, registered

    called = [cls for cls in registered().values() if cls.called == name]
    why = ""
    for cls in (*called, effect_class(name)):
        anything = {s.name: min(max(1.0, s.lower), s.upper) for s in cls.specs()}
        for place in cls.places:
            try:
                cls(place=place, **anything).ports(axis.chain)
                return
            except NotApplicableError as error:
                why = str(error)
    raise InputError(
        "--effects", f"{name!r} has no place in {model.name}: {why}", "effects that the axis can have", "leave it out"
    )
