"""Forms made from the command line, and names of uploaded files."""

from __future__ import annotations

import pytest

from mjsim.errors import InputError
from simgap.app.forms import FORMAT, Kind, forms
from simgap.app.uploads import LONGEST_NAME, safe_name
from simgap.cli import COMMANDS, cli


def test_a_form_for_every_command_that_a_run_can_hold():
    assert set(COMMANDS) - set(forms()) == {"app"}
    assert {
        "identify",
        "replay",
        "render",
        "crosscheck",
        "run",
        "gate",
        "check",
        "diagnose",
        "fleet",
        "effects",
        "doctor",
    } <= set(forms())
    for name, form in forms().items():
        options = {o for p in cli.get_command(None, name).params for o in p.opts}
        assert {f.option for f in form.fields if f.option} | ({form.output} if form.output else set()) <= options
        assert all(f.help for f in form.fields if f.option), name


@pytest.mark.parametrize("name", ["check", "diagnose", "identify", "replay", "render", "crosscheck", "run", "gate"])
def test_the_words_of_a_form_are_understood_by_the_command(name):
    """What the form writes, click reads back as the same values."""
    form = forms()[name]
    values, files = {}, {}
    for f in form.fields:
        if f.kind in (Kind.MODEL, Kind.SOURCE):
            files[f.name] = ["pendulum"]
        elif f.kind in (Kind.RECORDING, Kind.FILE):
            files[f.name] = ["recordings/-a.csv", "recordings/b.csv"][: 1 + f.several]
        elif f.kind is Kind.CHOICE:
            values[f.name] = f.choices[-1]
        else:
            values[f.name] = {Kind.FLAG: True, Kind.WHOLE: 7, Kind.NUMBER: max(0.5, f.low or 0), Kind.TEXT: "--x"}[f.kind]
    values = form.checked(values)
    words = form.words(values, files, f"out/{name}")
    read = cli.get_command(None, name).make_context(name, words[1:]).params
    for f in form.fields:
        if f.name == FORMAT:
            assert read["out"].suffix == values[FORMAT]
        elif f.kind in (Kind.RECORDING, Kind.FILE):
            got = read[f.name] if f.several else (read[f.name],)
            assert [p.as_posix() for p in got] == files[f.name]
        elif f.kind not in (Kind.MODEL, Kind.SOURCE):
            assert read[f.name] == ((values[f.name],) if f.several else values[f.name])


@pytest.mark.parametrize("name", ["", ".", "..", "/", "a/..", "\\", "...", "x." + "y" * 200])
def test_what_is_no_name_is_refused(name):
    with pytest.raises(InputError):
        safe_name(name)


def test_long_names_are_cut():
    assert safe_name("a" * 500 + ".csv") == "a" * (LONGEST_NAME - 4) + ".csv"
    assert safe_name("a" * 500) == "a" * LONGEST_NAME
