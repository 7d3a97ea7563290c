"""Axis -> a corrected copy of an authored MJCF, and back: over the registry, with short and reversible edits."""

from __future__ import annotations

import difflib
from functools import partial
from pathlib import Path
from xml.sax.saxutils import quoteattr

import mujoco
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mjcf_chains import Spec, chain_xml

from mjsim.axis import Axis
from mjsim.effects import BacklashLaw, NotApplicableError, effect_class, registered
from mjsim.errors import InputError
from mjsim.mjcf import check_writable, load_axis, load_model, write_corrected
from mjsim.mjcf.xmltext import XmlText
from mjsim.models import shipped_model

CHANGED = {"Jm": 5e-4, "Jg": 9.0, "ka": 4e4, "fm": 0.04, "dg": -50.0, "da": 25.0}
VALUES = {
    "gap_rad": 5e-4, "inertia_kgm2": 0.5, "stiffness_Nm_rad": 2.5e3, "peak": 2.0, "cycles_per_rev": 8.0, "time_constant_s": 0.004,
    "delay_s": 0.00321, "limit_Nm": 0.8, "torque_Nm": 0.1 / 3, "coefficient_Nm_rad3": 1e8,
    "lower_rad": -0.3, "upper_rad": 0.4,
}  # fmt: skip

PLACED = [(name, place) for name, cls in registered().items() for place in cls.places if cls.family != "servo"]


@pytest.fixture(scope="module")
def nominal() -> Path:
    return shipped_model("robot_axis1")


def make(name: str, place: str):
    cls = effect_class(name)
    return cls(place=place, **{s.name: VALUES.get(s.name, max(0.0123, s.lower)) for s in cls.specs()})


def without_correction(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    start, end = text.index("  <custom>"), text.index("</custom>\n") + len("</custom>\n")
    return text[:start] + text[end:]


@pytest.fixture(scope="module")
def axis(nominal) -> Axis:
    return load_axis(nominal)


@pytest.fixture(scope="module", params=PLACED, ids="-".join)
def corrected(request, nominal, axis, tmp_path_factory):
    """An axis that differs from the nominal one in an effect and its numbers, what is written of it and where."""
    other = (axis + make(*request.param)).with_linear(CHANGED)
    path = tmp_path_factory.mktemp("corrected") / "corrected.xml"
    return other, write_corrected(nominal, other, path), path


def test_every_effect_survives_the_round_trip_with_its_values_and_place(corrected):
    other, _, path = corrected
    assert load_axis(path) == other


def test_every_correction_can_be_taken_back(tmp_path, nominal, axis, corrected):
    write_corrected(corrected[2], axis, tmp_path / "back.xml")
    assert load_axis(tmp_path / "back.xml") == axis
    assert without_correction(tmp_path / "back.xml") == nominal.read_text(encoding="utf-8")


def test_what_plain_mujoco_lacks_is_said_in_a_comment(corrected):
    _, written, path = corrected
    comment = " ".join(path.read_text(encoding="utf-8").split("<custom>")[1].split("-->")[0].split())
    assert ("Plain MuJoCo lacks" in comment) == bool(written.lacks)
    for line in written.lacks:
        assert line in comment


def test_all_effects_together_survive(tmp_path, nominal):
    axis = load_axis(nominal)
    for name, place in PLACED:
        axis += make(name, place)
    write_corrected(nominal, axis, tmp_path / "corrected.xml")
    assert load_axis(tmp_path / "corrected.xml") == axis
    write_corrected(tmp_path / "corrected.xml", load_axis(nominal), tmp_path / "back.xml")
    assert without_correction(tmp_path / "back.xml") == nominal.read_text(encoding="utf-8")


def test_the_law_of_backlash_survives(tmp_path, nominal):
    axis = Axis(load_axis(nominal).chain, (make("backlash", "gearbox"),), BacklashLaw.NO_PULL)
    write_corrected(nominal, axis, tmp_path / "corrected.xml")
    assert load_axis(tmp_path / "corrected.xml").backlash_law is BacklashLaw.NO_PULL


def test_the_diff_to_the_nominal_file_is_short(tmp_path, nominal):
    axis = (load_axis(nominal) + make("coulomb_friction", "motor")).with_linear({"Jm": 5e-4})
    write_corrected(nominal, axis, tmp_path / "corrected.xml", "Found on log.csv.")
    old, new = nominal.read_text(encoding="utf-8"), without_correction(tmp_path / "corrected.xml")
    changed = [line for line in difflib.ndiff(old.splitlines(), new.splitlines()) if line.startswith("+ ")]
    assert len(changed) == 4  # timestep, the two halves of the inertia, the friction
    assert any('frictionloss="0.0333' in line and 'solreffriction="-1 -25000"' in line for line in changed)
    text = (tmp_path / "corrected.xml").read_text(encoding="utf-8")
    assert "Found on log.csv." in text
    assert "Jm 0.000456 -> 0.0005 kg m^2" in text


def test_native_friction_is_not_applied_twice(tmp_path, nominal):
    axis = load_axis(nominal) + make("coulomb_friction", "motor")
    write_corrected(nominal, axis, tmp_path / "corrected.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected.xml"))
    assert model.dof_frictionloss[0] == pytest.approx(0.1 / 3)
    assert [e.key for e in load_axis(tmp_path / "corrected.xml").effects] == ["coulomb_friction@motor"]


def test_an_authored_friction_stays_and_is_carried(tmp_path):
    text = shipped_model("emps").read_text(encoding="utf-8").replace('frictionloss="0"', 'frictionloss="20"')
    own = tmp_path / "own.xml"
    own.write_text(text, encoding="utf-8")
    axis = load_axis(own) + make("torque_offset", "motor")
    write_corrected(own, axis, tmp_path / "corrected.xml")
    assert load_axis(tmp_path / "corrected.xml") == axis
    assert 'frictionloss="20"' in (tmp_path / "corrected.xml").read_text(encoding="utf-8")


def test_a_correction_can_be_corrected(tmp_path, nominal):
    first = load_axis(nominal) + make("backlash", "gearbox")
    write_corrected(nominal, first, tmp_path / "one.xml")
    second = load_axis(tmp_path / "one.xml") + make("coulomb_friction", "motor")
    write_corrected(tmp_path / "one.xml", second, tmp_path / "two.xml")
    write_corrected(nominal, second, tmp_path / "direct.xml")
    assert without_correction(tmp_path / "two.xml") == without_correction(tmp_path / "direct.xml")
    assert load_axis(tmp_path / "two.xml") == second


def test_assets_are_found_from_another_directory(tmp_path):
    home = tmp_path / "home"
    (home / "meshes").mkdir(parents=True)
    corners = ("v 0 0 0", "v 1 0 0", "v 0 1 0", "v 0 0 1", "f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4")
    (home / "meshes" / "box.obj").write_text("\n".join(corners) + "\n")
    (home / "m.xml").write_text(
        '<mujoco><compiler meshdir="meshes" angle="radian"/><option gravity="0 0 0"/>'
        '<asset><mesh name="box" file="box.obj"/></asset><worldbody>'
        '<body name="b"><joint name="j" damping="1"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        '<geom type="mesh" mesh="box" contype="0" conaffinity="0"/></body></worldbody>'
        '<actuator><motor name="u" joint="j"/></actuator></mujoco>'
    )
    axis = load_axis(home / "m.xml").with_linear({"fm": 2.0})
    write_corrected(home / "m.xml", axis, tmp_path / "elsewhere" / "deep" / "corrected.xml")
    assert load_axis(tmp_path / "elsewhere" / "deep" / "corrected.xml") == axis


def test_inertia_from_geoms_is_written_out(tmp_path):
    own = tmp_path / "own.xml"
    own.write_text(
        '<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody><body name="b"><joint name="j" axis="0 0 1"/>'
        '<geom type="box" size=".1 .2 .3" pos=".3 .1 0" euler="0.3 0.2 0.1" contype="0" conaffinity="0"/></body></worldbody>'
        '<actuator><motor name="u" joint="j"/></actuator></mujoco>'
    )
    chain = load_axis(own).chain
    axis = load_axis(own).with_linear({"Jm": 1.7 * chain.bodies[0].inertia})
    write_corrected(own, axis, tmp_path / "corrected.xml")
    assert load_axis(tmp_path / "corrected.xml").chain.bodies[0].inertia == pytest.approx(1.7 * chain.bodies[0].inertia, rel=1e-9)


def test_nothing_half_written_is_left(tmp_path, nominal, monkeypatch):
    from mjsim.mjcf import write as module

    def fail(path):
        raise InputError(path, "MuJoCo does not load it")

    monkeypatch.setattr(module, "save_compiled", partial(module.save_compiled, load=fail))
    with pytest.raises(InputError):
        write_corrected(nominal, load_axis(nominal), tmp_path / "corrected.xml")
    assert list(tmp_path.iterdir()) == []


def test_the_axis_of_another_model_is_refused(tmp_path, nominal):
    with pytest.raises(InputError):
        write_corrected(nominal, load_axis(shipped_model("emps")), tmp_path / "corrected.xml")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('"version": 1', '"version": 7'), "version 7; expected version 1"),
        (('"version": 1,', '"version": '), "not readable"),
        (('"id": "backlash"', '"id": "slop"'), "unknown effect 'slop'; choose from"),
        (('"gap_rad": 0.0005', '"gap_rad": -1'), "expected 0.0 <= gap_rad"),
        (('"gap_rad"', '"gap"'), "gap"),
        (('"place": "gearbox"', '"place": "motor"'), "choose from gearbox, arm"),
    ],
)
def test_a_damaged_correction_is_one_line(tmp_path, nominal, change, said):
    write_corrected(nominal, load_axis(nominal) + make("backlash", "gearbox"), tmp_path / "corrected.xml")
    text = (tmp_path / "corrected.xml").read_text(encoding="utf-8")
    assert change[0] in text
    (tmp_path / "corrected.xml").write_text(text.replace(*change), encoding="utf-8")
    with pytest.raises(InputError, match=said) as caught:
        load_axis(tmp_path / "corrected.xml")
    assert "\n" not in str(caught.value)


positive = st.floats(1e-2, 1e2)


@settings(max_examples=12, deadline=None)
@given(data=st.data())
def test_any_chain_takes_any_effect_and_new_linear_parameters(tmp_path_factory, data):
    n = data.draw(st.integers(1, 4))
    draw = lambda size, scale=1.0: tuple(scale * data.draw(positive) for _ in range(size))  # noqa: E731
    spec = Spec(
        draw(n), data.draw(positive), draw(n - 1, 1e3), draw(n - 1), data.draw(st.floats(0.01, 3.0)),
        data.draw(st.sampled_from(["hinge", "slide"])), data.draw(st.sampled_from(["nested", "side"])), data.draw(positive),
    )  # fmt: skip
    work = tmp_path_factory.mktemp("chain")
    (work / "own.xml").write_text(chain_xml(spec))
    axis = load_axis(work / "own.xml")
    axis = axis.with_linear({p.name: p.value * data.draw(st.floats(0.5, 2.0)) for p in axis.chain.linear_parameters()})
    name, place = data.draw(st.sampled_from(PLACED))
    effect = make(name, place)
    try:
        effect.ports(axis.chain)
    except NotApplicableError:
        pass
    else:
        if not (name == "extra_flexible_mode" and axis.chain.bodies[-1].inertia <= 0.5):
            axis += effect
    write_corrected(work / "own.xml", axis, work / "corrected.xml")
    back = load_axis(work / "corrected.xml")
    assert back.effects == axis.effects
    assert [p.name for p in back.chain.linear_parameters()] == [p.name for p in axis.chain.linear_parameters()]
    for a, b in zip(back.chain.linear_parameters(), axis.chain.linear_parameters(), strict=True):
        assert a.value == pytest.approx(b.value, rel=1e-9), a.name
    assert back.chain.actuator == axis.chain.actuator
    assert back.chain.velocity_sensor == axis.chain.velocity_sensor


def test_the_bound_names_travel_without_the_toml_file(tmp_path):
    emps = shipped_model("emps")
    axis = load_axis(emps)
    write_corrected(emps, axis, tmp_path / "corrected.xml")
    assert load_axis(tmp_path / "corrected.xml") == axis
    carried = load_model(tmp_path / "corrected.xml").carried
    assert carried is not None
    assert 'column = "vir"' in carried.binding


# ---- the text editor ------------------------------------------------------------------------------------------------


def test_edits_touch_nothing_else():
    text = "<a>\n  <!-- <b x='1'> -->\n  <b  x = '1'\n      y=\"2>1\" />\n  <c>\n  </c>\n</a>\n"
    xml = XmlText(text)
    b = xml.find(lambda n: n.tag == "b")
    xml.set(b, "x", "7 & 8")
    xml.set(xml.find(lambda n: n.tag == "b"), "z", "3")
    assert xml.text == text.replace("x = '1'\n", 'x = "7 &amp; 8"\n').replace('2>1" />', '2>1" z="3" />')
    xml.set(xml.find(lambda n: n.tag == "b"), "z", None)
    xml.append(xml.find(lambda n: n.tag == "c"), ["<d/>"])
    xml.append(xml.find(lambda n: n.tag == "d"), ["<e/>"])
    assert "  <c>\n    <d>\n      <e/>\n    </d>\n  </c>\n" in xml.text
    xml.rename(xml.find(lambda n: n.tag == "c"), "long")
    assert "<long>" in xml.text
    assert "</long>" in xml.text
    xml.remove(xml.find(lambda n: n.tag == "long"))
    assert "long" not in xml.text


# ---- what can be written ----------------------------------------------------------------------------------------------

BOB = (
    '<body name="b"><joint name="j" axis="0 0 1" damping="0.1"/>'
    '<inertial pos="0.1 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body>'
)


def own_file(folder: Path, body: str = BOB, *, head: bytes = b"", motor: str = '<motor name="u" joint="j"/>') -> Path:
    text = f"<mujoco><option gravity='0 0 0'/><worldbody>{body}</worldbody><actuator>{motor}</actuator></mujoco>"
    (folder / "own.xml").write_bytes(head + text.encode())
    return folder / "own.xml"


@pytest.mark.parametrize("name", ["robot_axis1", "emps", "kuka_kr300_axis1"])
def test_shipped_models_are_writable(name):
    check_writable(shipped_model(name))


def test_a_corrected_file_is_writable(tmp_path, nominal):
    write_corrected(nominal, load_axis(nominal) + make("coulomb_friction", "motor"), tmp_path / "corrected.xml")
    check_writable(tmp_path / "corrected.xml")


NAMES = ["gear & box", 'a "quoted" <joint>', "d'Alembert -- 1", "Gelenk ä"]
FRICTION, RIPPLE, BRISTLE = (("coulomb_friction", "motor"), ("torque_ripple", "motor"), ("presliding_friction", "motor"))


@pytest.mark.parametrize(
    ("name", "effect"),
    [
        *((name, FRICTION) for name in NAMES),
        (NAMES[2], RIPPLE),
        (NAMES[1], BRISTLE),
        *(pytest.param(name, RIPPLE, marks=pytest.mark.slow) for name in NAMES if name != NAMES[2]),
        *(pytest.param(name, BRISTLE, marks=pytest.mark.slow) for name in NAMES if name != NAMES[1]),
    ],
)
def test_any_name_is_written_as_it_is(tmp_path, name, effect):
    text = quoteattr(name)
    own = own_file(tmp_path, BOB.replace('name="j"', f"name={text}"), motor=f'<motor name="u" joint={text}/>')
    check_writable(own)
    axis = load_axis(own) + make(*effect)
    write_corrected(own, axis, tmp_path / "corrected.xml")
    assert load_axis(tmp_path / "corrected.xml") == axis
    assert load_axis(tmp_path / "corrected.xml").chain.bodies[0].joint == name


@pytest.mark.parametrize("head", ["<!-- Trägheit -->", '<?xml version="1.0" encoding="ISO-8859-1"?><!-- Trägheit -->'])
def test_a_latin_1_comment_stays(tmp_path, head):
    own = own_file(tmp_path, head=head.encode("latin-1"))
    check_writable(own)
    axis = load_axis(own).with_linear({"fm": 0.2})
    write_corrected(own, axis, tmp_path / "corrected.xml")
    assert load_axis(tmp_path / "corrected.xml") == axis
    assert "Trägheit".encode("latin-1") in (tmp_path / "corrected.xml").read_bytes()


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (BOB.replace(' name="b"', ""), "a inertial has no name|body has no name"),
        (BOB.replace('<joint name="j"', "<!-- a & b --><joint name='j'").replace("0.1 0 0", "0.1 0 0&#x20;"), ""),
    ],
)
def test_what_cannot_be_written_is_refused_in_one_line(tmp_path, body, said):
    own = own_file(tmp_path, body)
    if not said:
        check_writable(own)
        return
    with pytest.raises(InputError, match=said) as caught:
        check_writable(own)
    assert "\n" not in str(caught.value)


def test_a_body_in_an_included_file_is_refused(tmp_path):
    (tmp_path / "part.xml").write_text(f"<mujoco><worldbody>{BOB}</worldbody></mujoco>")
    own = own_file(tmp_path, "")
    own.write_text(own.read_text().replace("<worldbody></worldbody>", '<include file="part.xml"/>'))
    with pytest.raises(InputError, match=r"is not in this file under that name.*merge included files"):
        check_writable(own)


def test_a_bare_ampersand_is_refused(tmp_path):
    own = own_file(tmp_path, BOB.replace('name="b"', 'name="b & c"'))
    with pytest.raises(InputError, match=r"well-formed|does not load"):
        check_writable(own)
