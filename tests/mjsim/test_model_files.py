"""Which files a model may read, whatever names it gives them, and copies of them beside a written model."""

from __future__ import annotations

import os

import click
import mujoco
import pytest
from click.testing import CliRunner

from mjsim.errors import InputError
from mjsim.mjcf import limits, load_axis, load_model, write_corrected
from mjsim.mjcf.assets import BESIDE, bring_assets
from mjsim.mjcf.compile import compile_file
from mjsim.mjcf.tags import tags, with_plain_comments
from mjsim.mjcf.whole import write_whole
from mjsim.mjcf.write import check_writable
from mjsim.mjcf.xmltext import XmlText
from simgap.arguments import model_root
from simgap.cli import cli

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
MODEL = """<mujoco>{head}<worldbody>{world}<body name="rod"><joint name="hinge" axis="0 1 0" damping=".05"/>
<geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass="1"/></body></worldbody>
<actuator><motor name="drive" joint="hinge"/></actuator>{more}</mujoco>"""
MESH = '<asset><mesh name="part" file="{}"/></asset>'


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder ``model`` beside files that are none of its business."""
    monkeypatch.setattr(limits, "_read", set())
    (tmp_path / "model" / "own").mkdir(parents=True)
    (tmp_path / "meshes").mkdir()
    for name in ("part.obj", "meshes/part.obj", "model/own/part.obj"):
        (tmp_path / name).write_text(OBJ)
    (tmp_path / "part.xml").write_text("<mujocoinclude><site/></mujocoinclude>")
    (tmp_path / "sub.xml").write_text('<mujoco><worldbody><body name="s"><geom size=".1"/></body></worldbody></mujoco>')
    return tmp_path


def written(folder, *, head="", world="", more=""):
    path = folder / "axis.xml"
    path.write_text(MODEL.format(head=head, world=world, more=more))
    return path


OUTSIDE = {
    "parent": {"more": MESH.format("../part.obj")},
    "absolute": {"more": MESH.format("{root}/part.obj")},
    "backslash": {"more": MESH.format("..\\part.obj")},
    "reference": {"more": MESH.format("&#46;&#x2e;/part.obj")},
    "folder": {"head": '<compiler meshdir="../meshes"/>', "more": MESH.format("part.obj")},
    "folder-backslash": {"head": '<compiler assetdir="..\\meshes"/>', "more": MESH.format("part.obj")},
    "strippath": {"head": '<compiler strippath="true" meshdir=".."/>', "more": MESH.format("nowhere/part.obj")},
    "link": {"more": MESH.format("link.obj")},
    "linked-folder": {"more": MESH.format("linked/part.obj")},
    "below-a-link": {"more": MESH.format("linked/../part.obj")},
    "texture": {"more": '<asset><texture name="t" type="2d" file="../part.obj"/></asset>'},
    "cube": {"more": '<asset><texture name="t" type="cube" fileright="../part.obj"/></asset>'},
    "height field": {"more": '<asset><hfield name="h" size="1 1 1 1" file="../part.obj"/></asset>'},
    "skin": {"more": '<deformable><skin name="s" file="../part.obj"/></deformable>'},
    "flex": {"world": '<body name="f"><flexcomp name="f" type="mesh" file="../part.obj" dim="2"/></body>'},
    "sub-model": {"more": '<asset><model name="s" file="../sub.xml"/></asset>'},
    "include": {"world": '<include file="../part.xml"/>'},
    "include-backslash": {"world": '<include file="..\\part.xml"/>'},
    "include-reference": {"world": "<include file='&#46;./part.xml'/>"},
    "include-in-quotes": {"world": '<site name="&lt;!--"/><site name="<!--"/><include file="../part.xml"/><site name="-->"/>'},
    "include-after-doctype": {"head": "<!DOCTYPE a [ <!-- > ", "world": '<include file="../part.xml"/>'},
    "included": {"world": '<include file="own/more.xml"/>'},
}


@pytest.mark.parametrize("name", list(OUTSIDE))
def test_a_file_outside_the_folder_is_refused_however_it_is_named(place, name):
    (place / "model" / "link.obj").symlink_to(place / "part.obj")
    (place / "model" / "linked").symlink_to(place / "meshes")
    (place / "model" / "own" / "more.xml").write_text(f"<mujocoinclude>{MESH.format('../../part.obj')}</mujocoinclude>")
    path = written(place / "model", **{k: v.replace("{root}", str(place)) for k, v in OUTSIDE[name].items()})
    with pytest.raises(InputError, match="outside its folder") as error:
        compile_file(path)
    assert len(str(error.value).splitlines()) == 1
    assert f"--model-root {place}" in str(error.value)


def test_a_file_inside_is_read_and_one_that_is_missing_is_named(place):
    assert compile_file(written(place / "model", more=MESH.format("own/part.obj"))).nmesh == 1
    assert compile_file(written(place / "model", more=MESH.format("own\\part.obj"))).nmesh == 1
    assert compile_file(written(place / "model", more=MESH.format("own/../own/part.obj"))).nmesh == 1
    with pytest.raises(InputError, match=r"nowhere\.obj"):
        compile_file(written(place / "model", more=MESH.format("../nowhere.obj")))


def test_a_folder_that_is_allowed(place, monkeypatch):
    path = written(place / "model", head='<compiler meshdir="../meshes"/>', more=MESH.format("part.obj"))
    monkeypatch.setenv(limits.ROOTS, os.pathsep.join(["", str(place / "model"), str(place / "meshes")]))
    assert compile_file(path).nmesh == 1
    monkeypatch.setenv(limits.ROOTS, str(place / "mesh"))  # a name that only begins alike
    monkeypatch.setattr(limits, "_read", set())
    with pytest.raises(InputError, match="outside its folder"):
        compile_file(path)


def test_a_model_that_is_a_link_has_two_folders(place):
    written(place / "model", more=MESH.format("own/part.obj"))
    (place / "elsewhere" / "own").mkdir(parents=True)
    (place / "elsewhere" / "own" / "part.obj").symlink_to(place / "model" / "own" / "part.obj")
    (place / "elsewhere" / "axis.xml").symlink_to(place / "model" / "axis.xml")
    assert compile_file(place / "elsewhere" / "axis.xml").nmesh == 1


def test_the_limit_of_meshes(place, monkeypatch):
    path = written(place / "model", more=MESH.format("own/part.obj"))
    monkeypatch.setattr(limits, "MOST_ASSETS", len(OBJ))
    limits.need_sizes(path)
    monkeypatch.setattr(limits, "MOST_ASSETS", len(OBJ) - 1)
    with pytest.raises(InputError, match="meshes and textures have more than"):
        limits.need_sizes(path)


@pytest.mark.parametrize("name", ["\0", "x" * 5000, "own", "", "loop"])
def test_a_name_that_is_no_file_is_left_to_mujoco(place, name):
    (place / "model" / "loop").symlink_to("loop")
    with pytest.raises(InputError, match="MuJoCo does not load it"):
        compile_file(written(place / "model", more=MESH.format(name.replace("\0", "&#0;"))))


def test_the_option_of_the_command_line(place, monkeypatch):
    """``--model-root`` allows a folder while the command runs, and no longer."""
    path = written(place / "model", head='<compiler meshdir="../meshes"/>', more=MESH.format("part.obj"))
    monkeypatch.setenv(limits.ROOTS, "/nowhere")

    @click.command()
    @model_root
    def command() -> None:
        click.echo(compile_file(path).nmesh)

    refused = CliRunner().invoke(command, [])
    assert "outside its folder" in str(refused.exception)
    allowed = CliRunner().invoke(command, ["--model-root", str(place / "sub"), "--model-root", str(place / "meshes")])
    assert allowed.exit_code == 2  # no such folder
    allowed = CliRunner().invoke(command, ["--model-root", str(place / "model"), "--model-root", str(place / "meshes")])
    assert allowed.output == "1\n"
    assert os.environ[limits.ROOTS] == "/nowhere"


@pytest.mark.parametrize("name", ["check", "diagnose", "fleet", "gate", "replay", "render", "run", "crosscheck"])
def test_every_command_that_reads_a_model_has_the_option(name):
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    assert any("--model-root" in p.opts for p in command.params)


def test_a_written_model_has_its_files_beside_it(place, monkeypatch):
    """Two meshes of one name and a texture that is named in the folder of meshes: the copy loads where nothing else is."""
    head = '<compiler meshdir="../meshes" strippath="false"/>'
    more = '<asset><mesh name="a" file="part.obj"/><mesh name="b" file="../part.obj" scale="2 2 2"/></asset>'
    monkeypatch.setenv(limits.ROOTS, str(place))
    path = written(place / "model", head=head, more=more)
    axis = load_axis(path).with_linear({"fm": 2.0})
    out = place / "report" / "corrected.xml"
    write_corrected(path, axis, out)
    bring_assets(out)
    assert sorted(p.relative_to(out.parent).as_posix() for p in out.parent.rglob("*") if p.is_file()) == [
        "corrected.xml", f"{BESIDE}/1/part.obj", f"{BESIDE}/part.obj"
    ]  # fmt: skip
    monkeypatch.delenv(limits.ROOTS)
    monkeypatch.setattr(limits, "_read", set())
    (place / "report").rename(place / "moved")
    assert load_axis(place / "moved" / "corrected.xml") == axis
    before = (place / "moved" / "corrected.xml").read_bytes()
    bring_assets(place / "moved" / "corrected.xml")
    assert (place / "moved" / "corrected.xml").read_bytes() == before


def test_a_model_without_a_compiler_element_is_written_elsewhere(place):
    path = written(place / "model", more=MESH.format("own/part.obj"))
    axis = load_axis(path)
    write_corrected(path, axis, place / "report" / "corrected.xml")
    bring_assets(place / "report" / "corrected.xml")
    assert mujoco.MjModel.from_xml_path(str(place / "report" / "corrected.xml")).nmesh == 1
    assert (place / "report" / BESIDE / "part.obj").is_file()


def test_dashes_in_a_comment(place):
    """XML forbids ``--`` in a comment; MuJoCo takes it, and many files have a rule of dashes."""
    text = "<!-- ------ links ------ --><!-- a--b ---><!---->"
    path = written(place / "model", head=text)
    check_writable(path, load_axis(path))
    out = place / "corrected.xml"
    write_corrected(path, load_axis(path).with_linear({"fm": 2.0}), out)
    assert text in out.read_text()
    load_model(out)
    assert XmlText.read(path).text == path.read_text()
    (place / "model" / "more.xml").write_text(f"<mujocoinclude>{text}<site/></mujocoinclude>")
    whole = write_whole(written(place / "model", world='<include file="more.xml"/>'), place / "model" / "nominal.xml")
    assert "<!-- ====== links ====== -->" in whole.read_text()


def test_comments_keep_their_places():
    raw = b"<a><!-- x -- y --->\n<b c='<!-- -- -->'/><!-- plain --></a>"
    plain = with_plain_comments(raw, "it")
    assert plain == b"<a><!-- x == y -=-->\n<b c='<!-- -- -->'/><!-- plain --></a>".replace(b"-=-->", b"=-->")
    assert len(plain) == len(raw)


def test_tags_of_a_text():
    raw = b"""<?xml version="1.0"?><!-- <no/> --><a b = '1' c="&lt;&#65;&quot;&none;"><![CDATA[<no>]]><d-e:f/>text & more</a >"""
    found = [(t.name, t.attributes, t.opens, t.closes) for t in tags(raw, "it")]
    assert found == [
        ("a", (("b", b"1"), ("c", b'<A"&none;')), True, False), ("d-e:f", (), True, True), ("a", (), False, True)
    ]  # fmt: skip
    for bad in (b"<a>\n<", b"<a>\n<1/>", b"<a>\n<b c=1/>", b"<a>\n<!-- "):
        with pytest.raises(InputError, match="line 2 is not XML"):
            list(tags(bad, "it"))
