"""The names that other programs may import: they are there, they are documented, and they are typed."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import typing

import pytest

import diagnose
import ident
import lab
import mjsim
import simgap

PUBLIC = {
    "mjsim.axis": ["Axis", "Body", "Chain", "Coupling", "LinearParameter"],
    "mjsim.effects": ["Effect", "NotApplicableError", "ParameterSpec", "Scales", "effect_class", "register", "registered"],
    "mjsim.errors": ["CheckError", "InputError"],
    "mjsim.mjcf": ["load_axis", "load_model", "write_corrected"],
    "mjsim.models": ["shipped_model", "shipped_models"],
    "mjsim.ode": ["DivergedError", "Trajectory", "inverse", "simulate"],
    "mjsim.quantity": ["Motion", "Quantity"],
    "mjsim.recording": ["Binding", "Channel", "Recording", "load"],
    "mjsim.scenario": ["load_scenario", "run", "shipped_scenarios", "write_log"],
    "ident": ["IOData", "Structure", "bj", "bode", "decimate", "residual_tests", "select_order", "shared_filter"],
    "diagnose.pipeline": ["Options", "diagnose"],
    "diagnose.result": ["Diagnosis", "Estimate", "Finding", "FitFigures", "Mismatch", "Verdict"],
    "diagnose.report": ["write_report"],
    "simgap.pipeline": ["corrected_axis", "diagnose_files"],
    "simgap": [
        "Diagnosis",
        "Identification",
        "InputError",
        "Model",
        "Recording",
        "RobotRecording",
        "__version__",
        "check",
        "diagnose",
        "effects",
        "identify",
        "load",
        "simulate",
    ],
}


def modules():
    for package in (mjsim, ident, diagnose, simgap, lab):
        yield package.__name__
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not found.name.endswith("__main__"):
                yield found.name


@pytest.mark.parametrize("name", list(PUBLIC))
def test_public_names_stay(name):
    module = importlib.import_module(name)
    assert set(PUBLIC[name]) <= set(module.__all__)


def test_public_things_say_what_they_are():
    silent = []
    for name in modules():
        module = importlib.import_module(name)
        things = {attribute: getattr(module, attribute) for attribute in getattr(module, "__all__", [])}
        texts = {name: module.__doc__}
        texts |= {f"{name}.{a}": inspect.getdoc(x) for a, x in things.items() if inspect.isclass(x) or inspect.isfunction(x)}
        silent += [what for what, text in texts.items() if not text]
    assert not silent


@pytest.mark.parametrize("name", list(PUBLIC))
def test_public_functions_are_typed(name):
    module = importlib.import_module(name)
    for attribute in PUBLIC[name]:
        thing = getattr(module, attribute)
        if inspect.isfunction(thing):
            hints = typing.get_type_hints(thing)
            assert "return" in hints, f"{name}.{attribute}"
            assert set(inspect.signature(thing).parameters) <= set(hints), f"{name}.{attribute}"


def test_the_version_is_that_of_the_installed_package():
    from importlib.metadata import version

    assert version("simgap") == simgap.__version__
