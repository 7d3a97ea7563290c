"""Models that spread over files, or whose elements have no names, become one file with names."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from mjsim.errors import InputError
from mjsim.mjcf import check_writable, load_axis
from mjsim.mjcf.whole import is_whole, write_whole
from mjsim.models import shipped_model

ARM = """<mujoco model="arm"><compiler angle="radian"/><default><default class="j">
<joint axis="0 1 0" damping=".05" armature=".01"/></default></default><worldbody>
<body name="rod"><joint class="j" name="hinge"/><geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass="1"/></body>
</worldbody>
<actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", ["robot_axis1", "arm3"])
def test_shipped_models_are_left_as_they_are(name):
    assert is_whole(shipped_model(name))


@pytest.mark.parametrize("remove", ['name="rod"', 'name="drive"', 'name="hinge"'])
def test_elements_without_a_name_get_one(tmp_path, remove):
    text = ARM.replace(remove, "")
    if "hinge" in remove:
        text = text.replace('<motor name="drive" joint="hinge"/>', "")
    own = write(tmp_path, "own.xml", text)
    assert not is_whole(own)
    named = write_whole(own, tmp_path / "out" / "nominal.xml")
    assert is_whole(named)


def test_an_included_file(tmp_path):
    write(tmp_path, "arm.xml", ARM)
    scene = write(tmp_path, "scene.xml", '<mujoco><include file="arm.xml"/><worldbody><light pos="0 0 3"/></worldbody></mujoco>')
    scene.with_suffix(".toml").write_text("[experiment]\nloop = 'open'\n")
    assert not is_whole(scene)
    with pytest.raises(InputError):
        check_writable(scene)
    whole = write_whole(scene, tmp_path / "out" / "nominal.xml")
    check_writable(whole)
    assert whole.with_suffix(".toml").read_text() == scene.with_suffix(".toml").read_text()
    before, after = load_axis(scene).chain, load_axis(whole).chain
    np.testing.assert_allclose(
        [p.value for p in before.linear_parameters()], [p.value for p in after.linear_parameters()], rtol=1e-9
    )


def test_meshes_stay_where_they_are(tmp_path):
    vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "meshes").mkdir()
    write(tmp_path / "meshes", "part.obj", vertices)
    text = ARM.replace('"radian"/>', '"radian" meshdir="meshes"/><asset><mesh file="part.obj"/></asset>').replace(
        'name="rod"', ""
    )
    own = write(tmp_path, "own.xml", text.replace("</body>", '<geom type="mesh" mesh="part" mass=".1"/></body>'))
    whole = write_whole(own, tmp_path / "out" / "deep" / "nominal.xml")
    assert mujoco.MjModel.from_xml_path(str(whole)).nmesh == 1


def test_a_name_that_is_taken_is_not_given_again(tmp_path):
    text = ARM.replace('name="drive"', "").replace('"hinge"', '"actuator0"')
    own = write(tmp_path, "own.xml", text.replace("</actuator>", '<motor name="actuator0" joint="actuator0"/></actuator>'))
    model = mujoco.MjModel.from_xml_path(str(write_whole(own, tmp_path / "nominal.xml")))
    assert sorted(model.actuator(i).name for i in range(2)) == ["actuator0", "actuator1"]


def test_what_is_no_model_is_left_to_its_reader(tmp_path):
    assert is_whole(write(tmp_path, "bad.xml", "<mujoco"))
    with pytest.raises(InputError, match="line 1 is not XML"):
        write_whole(tmp_path / "bad.xml", tmp_path / "nominal.xml")


@pytest.mark.parametrize("included", [False, True])
def test_every_digit_of_a_number_is_kept(tmp_path, included):
    text = (
        ARM.replace('name="rod"', "")
        .replace('damping=".05"', 'damping="0.0512345678901234"')
        .replace('mass="1"', 'mass="1.23456789012345"')
    )
    own = write(tmp_path, "arm.xml", text)
    if included:
        own = write(tmp_path, "scene.xml", '<mujoco><!-- two files --><include file="arm.xml"/></mujoco>')
    whole = write_whole(own, tmp_path / "out" / "nominal.xml")
    a, b = (mujoco.MjModel.from_xml_path(str(p)) for p in (own, whole))
    np.testing.assert_array_equal(a.dof_damping, b.dof_damping)
    np.testing.assert_array_equal(a.body_mass, b.body_mass)
    assert ("two files" in whole.read_text()) is included


def test_a_file_that_includes_itself_is_one_line(tmp_path):
    own = write(tmp_path, "own.xml", '<mujoco><include file="own.xml"/></mujoco>')
    with pytest.raises(InputError):
        write_whole(own, tmp_path / "out.xml")
