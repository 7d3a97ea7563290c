"""MJCF that expands without bound, refers to what is no file, or holds no numbers: refused before a fit, in one line."""

from __future__ import annotations

import os

import mujoco
import pytest

from mjsim.errors import InputError
from mjsim.mjcf import limits, load_model
from mjsim.models import shipped_model

MODEL = """<mujoco><compiler meshdir="m"/><worldbody>{world}<body name="rod"{body}>
<joint name="hinge" axis="0 1 0" damping="{damping}"/><geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass="1"/></body>
</worldbody><actuator><motor name="drive" joint="hinge"/></actuator>{more}</mujoco>"""


def written(folder, *, world="", body="", damping="0.05", more=""):
    path = folder / "axis.xml"
    path.write_text(MODEL.format(world=world, body=body, damping=damping, more=more))
    return path


def test_the_model_itself_loads(tmp_path):
    load_model(written(tmp_path, world='<!-- <replicate count="1e8"/> -->'))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"damping": "nan"}, r"dof_damping\[0\] is not finite"),
        ({"body": ' pos="0 0 inf"'}, r"body_pos\[1, 2\] is not finite"),
        ({"body": ' pos="nan 0 0"'}, r"body_pos\[1, 0\] is not finite"),
        ({"world": '<replicate count="100000000"><site/></replicate>'}, "1e\\+08 copies"),
        ({"world": '<replicate count="2000"><replicate count="2000"><site/></replicate></replicate>'}, "4e\\+06 copies"),
        ({"more": "<keyframe>" + "<key/>" * (limits.MOST_KEYS + 1) + "</keyframe>"}, "10001 keyframes"),
    ],
)
def test_what_is_refused(tmp_path, changed, said):
    with pytest.raises(InputError, match=said):
        load_model(written(tmp_path, **changed))


@pytest.mark.parametrize("inside", ["", "m"])
def test_a_mesh_that_is_a_pipe(tmp_path, inside):
    (tmp_path / "m").mkdir()
    os.mkfifo(tmp_path / inside / "part.stl")
    path = written(tmp_path, more='<asset><mesh name="part" file="part.stl"/></asset>')
    with pytest.raises(InputError, match="not a regular file"):
        load_model(path)


def test_the_limit_of_copies(monkeypatch, tmp_path):
    path = written(tmp_path, world='<replicate count="7" offset="1 0 0"><site/></replicate>')
    monkeypatch.setattr(limits, "MOST_COPIES", 7)
    limits.need_sizes(path)
    monkeypatch.setattr(limits, "MOST_COPIES", 6)
    with pytest.raises(InputError, match="7 copies"):
        limits.need_sizes(path)


def test_a_name_that_is_not_utf_8_is_refused(tmp_path):
    path = tmp_path / "axis.xml"
    path.write_bytes(shipped_model("pendulum").read_bytes().replace(b'<body name="', b'<body name="\xe9', 1))
    with pytest.raises(InputError, match=r"xe9.*is not UTF-8"):
        load_model(path)


def test_a_carried_text_that_is_not_utf_8_is_refused(tmp_path):
    path = written(tmp_path, more='<custom><text name="simgap" data="AB"/></custom>')
    path.write_bytes(path.read_bytes().replace(b'"AB"', b'"\x88"'))
    with pytest.raises(InputError, match="is not UTF-8"):
        load_model(path)


def test_limits_hold_for_what_is_included(tmp_path):
    (tmp_path / "part.xml").write_text('<mujocoinclude><replicate count="5000"><site/></replicate></mujocoinclude>')
    path = written(tmp_path, world='<replicate count="3"><include file="part.xml"/></replicate>')
    with pytest.raises(InputError, match=r"1\.5e\+04 copies"):
        load_model(path)


def test_an_included_file_outside_the_folder_is_refused(tmp_path):
    (tmp_path / "secret.xml").write_text("<mujocoinclude/>")
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "link.xml").symlink_to(tmp_path / "secret.xml")
    for name in ("../secret.xml", str(tmp_path / "secret.xml"), "link.xml"):
        path = written(tmp_path / "model", world=f'<include file="{name}"/>')
        with pytest.raises(InputError, match="outside its folder"):
            load_model(path)
    (tmp_path / "model" / "own.xml").write_text("<mujocoinclude><site/></mujocoinclude>")
    load_model(written(tmp_path / "model", world='<include file="own.xml"/>'))


def test_the_limit_of_included_files(monkeypatch, tmp_path):
    (tmp_path / "a.xml").write_text('<mujocoinclude><include file="b.xml"/></mujocoinclude>')
    (tmp_path / "b.xml").write_text("<mujocoinclude/>")
    path = written(tmp_path, world='<include file="a.xml"/>')
    monkeypatch.setattr(limits, "MOST_FILES", 2)
    limits.need_sizes(path)
    monkeypatch.setattr(limits, "MOST_FILES", 1)
    with pytest.raises(InputError, match="more than 1 files"):
        limits.need_sizes(path)


def test_an_included_pipe_is_refused(tmp_path):
    os.mkfifo(tmp_path / "part.xml")
    with pytest.raises(InputError, match="not a regular file"):
        load_model(written(tmp_path, world='<include file="part.xml"/>'))


def test_an_include_in_a_comment_is_none(tmp_path):
    load_model(written(tmp_path, world='<!-- <include file="../secret.xml"/> -->'))


ABSURD = {
    "height field": ('<asset><hfield name="h" nrow="{}" ncol="4096" size="1 1 1 1"/></asset>', 4096, "nrow times ncol"),
    "texture": ('<asset><texture name="t" type="2d" builtin="checker" width="4096" height="{}"/></asset>', 4096, "<texture>"),
    "user values": ('<size nuser_geom="{}"/>', 10_000, "nuser_geom"),
    "iterations": ('<option iterations="{}"/>', 100_000, "<option>"),
    "grid": ('<worldbody><body name="f"><flexcomp name="f" count="100 {} 1"/></body></worldbody>', 100, "<flexcomp>"),
}


@pytest.mark.parametrize("name", list(ABSURD))
def test_an_absurd_size_is_refused_before_memory_is_taken(tmp_path, name):
    text, most, said = ABSURD[name]
    limits.need_sizes(written(tmp_path, more=text.format(most)))
    with pytest.raises(InputError, match=f"{said}.*at most"):
        limits.need_sizes(written(tmp_path, more=text.format(most + 1)))
    with pytest.raises(InputError, match=f"{said}.*at most"):
        limits.need_sizes(written(tmp_path, more=text.format("nan")))


@pytest.mark.parametrize("tag", ["geom", "body", "joint", "site"])
def test_the_limit_of_elements_counts_copies(monkeypatch, tmp_path, tag):
    path = written(
        tmp_path, world=f'<body name="b"><replicate count="3"><replicate count="2"><{tag}/></replicate></replicate></body>'
    )
    most = {"geom": 7, "body": 8, "joint": 7, "site": 6}[tag]  # those of the model itself among them
    monkeypatch.setattr(limits, "MOST_ELEMENTS", most)
    limits.need_sizes(path)
    monkeypatch.setattr(limits, "MOST_ELEMENTS", most - 1)
    with pytest.raises(InputError, match=f"more than {most - 1} <{tag}>"):
        limits.need_sizes(path)


NOT_FINITE = [
    ({"more": '<option timestep="nan"/>'}, "timestep"),
    ({"more": '<option gravity="0 0 inf"/>'}, "gravity"),
    ({"more": '<option density="nan"/>'}, "density"),
    ({"more": '<actuator><motor joint="hinge" ctrlrange="nan nan" ctrllimited="true"/></actuator>'}, "actuator_ctrlrange"),
    ({"more": '<equality><joint joint1="hinge" solref="nan nan"/></equality>'}, "eq_solref"),
    ({"world": '<site pos="nan 0 0"/>'}, "site_pos"),
    ({"more": '<keyframe><key qpos="nan"/></keyframe>'}, "key_qpos"),
]


@pytest.mark.parametrize(("changed", "said"), NOT_FINITE)
def test_nan_anywhere_is_refused(tmp_path, changed, said):
    with pytest.raises(InputError, match=f"{said}.* is not finite"):
        load_model(written(tmp_path, **changed))


def test_an_infinite_range_is_none(tmp_path):
    more = '<actuator><motor joint="hinge" forcerange="-inf inf" forcelimited="true"/></actuator>'
    limits.need_finite(mujoco.MjModel.from_xml_path(str(written(tmp_path, more=more))), tmp_path)


@pytest.mark.parametrize("step", ["0", "-1e-3", "9e-9"])
def test_a_timestep_that_never_ends_a_run(tmp_path, step):
    load_model(written(tmp_path, more='<option timestep="1e-8"/>'))
    with pytest.raises(InputError, match="timestep"):
        load_model(written(tmp_path, more=f'<option timestep="{step}"/>'))
