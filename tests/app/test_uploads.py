"""Folders and ZIP archives: what is kept, what is refused, and that nothing leaves its folder."""

from __future__ import annotations

import io
import json
import stat
import zipfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("starlette", reason="starlette is not installed: pip install simgap[app]")
pytest.importorskip("httpx2", reason="httpx2 is not installed: pip install simgap[dev]")

from starlette.testclient import TestClient

from mjsim.errors import InputError
from simgap.app import uploads
from simgap.app.runs import Runs
from simgap.app.server import make_app
from simgap.app.uploads import DEEPEST, LONGEST_NAME, MOST_EPISODES, main_model, recordings_in, safe_path, unpack

TOKEN, PORT = "right", 8124
ARM = '<mujoco><compiler meshdir="assets"/><include file="parts/link.xml"/></mujoco>'
LINK = '<mujoco><worldbody><body><geom type="mesh" mesh="link"/></body></worldbody></mujoco>'


def packed(files: dict[str, str | bytes], **wanted) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", **wanted) as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return out.getvalue()


@pytest.fixture
def client(tmp_path):
    with TestClient(make_app(tmp_path / "runs", TOKEN, PORT), base_url=f"http://127.0.0.1:{PORT}") as client:
        client.cookies.set(f"simgap-{PORT}", TOKEN)
        yield client


@pytest.fixture
def run(client, tmp_path):
    return Runs(tmp_path / "runs").get(client.post("/api/runs", json={"name": "first"}).json()["id"])


def again(run):
    return Runs(run.folder.parent).get(run.id)


def refusal(answer):
    assert answer.status_code == 400, answer.text
    text = answer.json()["error"]
    assert len(text.splitlines()) == 1
    return text


def test_a_model_with_meshes_and_included_files_in_a_zip(client, run):
    files = {"arm.xml": ARM, "parts/link.xml": LINK, "assets/my link.stl": b"x", "README.md": "read me", ".git/config": "",
             "__MACOSX/arm.xml": "x"}  # fmt: skip
    answer = client.put(f"/api/runs/{run.id}/model/My%20arm.zip", content=packed(files))
    assert answer.json() == {
        "names": ["My_arm/arm.xml", "My_arm/assets/my link.stl", "My_arm/parts/link.xml"],
        "left_out": 1,
    }
    assert again(run).settings.model == "model/My_arm/arm.xml"
    assert again(run).entries("model") == {"My_arm": 3}
    page = client.get(f"/runs/{run.id}").text
    assert "folder of 3 files" in page
    made = Runs(run.folder.parent).get(client.post(f"/api/runs/{run.id}/copy", json={}).json()["id"])
    assert made.files("model") == again(run).files("model")
    assert client.delete(f"/api/runs/{run.id}/model/My_arm").status_code == 200
    assert again(run).files("model") == []
    assert again(run).settings.model == ""
    assert client.delete(f"/api/runs/{run.id}/model/My_arm").status_code == 404


def test_a_folder_file_by_file_chooses_the_model_that_no_other_includes(client, run):
    for name, text in (
        ("arm/a_link.xml", LINK),
        ("arm/arm.xml", ARM.replace("parts/link", "a_link")),
        ("arm/assets/link.stl", "x"),
    ):
        assert client.put(f"/api/runs/{run.id}/model/{name}", content=text.encode()).json() == {"name": name}
    assert again(run).settings.model == "model/arm/arm.xml"


def test_recordings_of_a_zip_are_named_by_their_paths_and_kept_apart(client, run, log):
    files = {"logs/a.csv": log, "logs/b.csv": log, "logs/b.toml": "", "logs/notes.md": ""}
    assert client.put(f"/api/runs/{run.id}/recordings/x.zip", content=packed(files)).json()["left_out"] == 1
    assert again(run).recordings == ["logs/a.csv", "logs/b.csv"]
    settings = {"model": "pendulum", "held_out": ["logs/b.csv"]}
    assert client.post(f"/api/runs/{run.id}/settings", json=settings).status_code == 200
    words = again(run).words("diagnose")
    assert "--held-out=recordings/logs/b.csv" in words
    assert words[-2:] == ["--", "recordings/logs/a.csv"]
    client.post(f"/api/runs/{run.id}/settings", json={"left_out": ["logs/a.csv"]})
    assert again(run).words("check")[-1] == "recordings/logs/b.csv"
    assert client.put(f"/api/runs/{run.id}/recordings/x.zip", content=packed({"logs/c.csv": log})).status_code == 201
    assert again(run).recordings == ["logs/c.csv"]


@pytest.mark.slow
def test_a_recording_of_a_zip_has_a_picture(client, run, log):
    client.put(f"/api/runs/{run.id}/recordings/x.zip", content=packed({"logs/a.csv": log}))
    assert client.get(f"/api/runs/{run.id}/picture/logs/a.csv").json()["svg"].startswith("<svg ")


def test_a_data_set_is_one_recording_or_its_episodes(tmp_path):
    for name, count in (("one", 1), ("many", 12), ("huge", 10**9), ("bad", "x")):
        (tmp_path / name / "meta").mkdir(parents=True)
        info = {"total_episodes": count, "fps": 30, "features": {}, "data_path": ""}
        (tmp_path / name / "meta" / "info.json").write_text(json.dumps(info))
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").touch()
    (tmp_path / "bag" / "bag_0.db3").touch()
    (tmp_path / "a.csv").touch()
    (tmp_path / ".b.csv").touch()
    found = recordings_in(tmp_path)
    assert [n for n in found if n.startswith("many")] == [f"many#{i}" for i in range(12)]
    assert len([n for n in found if n.startswith("huge")]) == MOST_EPISODES
    assert [n for n in found if "#" not in n] == ["a.csv", "bad", "bag", "one"]


BAD = ("../a.csv", "/etc/a.csv", "a/../../b.csv", "C:/a.csv", "a\\..\\..\\b.csv", "..", "a//b.csv", "a/-b.csv", "a/b .csv/c.csv ",
       "a/b#1.csv", "a/CON?.csv", "a" * (LONGEST_NAME + 1) + ".csv", "a/" * (DEEPEST + 1) + "b.csv")  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_zip_with_a_path_that_leads_out_changes_nothing(client, run, name):
    content = packed({"good.csv": "x", name: "x"})
    refusal(client.put(f"/api/runs/{run.id}/recordings/x.zip", content=content))
    assert list((run.folder / "recordings").iterdir()) == []
    assert {p.name for p in run.folder.parent.iterdir()} == {run.id}


@given(st.text(alphabet="ab./\\ :-#\x00ü", max_size=12))
def test_a_path_is_kept_inside_or_refused(path):
    root = Path("/run/recordings")
    try:
        kept = safe_path(path)
    except InputError:
        return
    assert kept == path
    assert ".." not in Path(kept).parts
    assert (root / kept).is_relative_to(root)
    assert (root / kept) != root


def linked() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        info = zipfile.ZipInfo("logs/a.csv")
        info.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(info, "/etc/passwd")
    return out.getvalue()


def encrypted() -> bytes:
    content = bytearray(packed({"a.csv": "x"}))
    content[content.index(b"PK\x01\x02") + 8] |= 1  # the flag in the directory
    return bytes(content)


def broken() -> bytes:
    content = bytearray(packed({"a.csv": "x" * 100}))
    content[content.index(b"xxx")] ^= 1
    return bytes(content)


@pytest.mark.parametrize(("content", "told"), [
    (linked, "is a link"), (encrypted, "encrypted"), (broken, "not a readable ZIP"), (lambda: b"PK", "not a readable ZIP"),
    (lambda: packed({"a.md": ""}), "no file that is read here"), (lambda: packed({}), "no file that is read here"),
    (lambda: packed({"a.csv": "", "a.csv/b.csv": ""}), "not a readable ZIP"),
])  # fmt: skip
def test_a_zip_that_cannot_be_unpacked_is_told_in_one_line(client, run, content, told):
    assert told in refusal(client.put(f"/api/runs/{run.id}/recordings/x.zip", content=content()))
    assert list((run.folder / "recordings").iterdir()) == []


def test_a_file_twice_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "x.zip", "w") as archive:
        archive.writestr("a.csv", "1")
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("a.csv", "2")
    (tmp_path / "to").mkdir()
    with pytest.raises(InputError, match="twice"):
        unpack(tmp_path / "x.zip", "x.zip", tmp_path / "to", "recordings", 10)


def test_the_limits_of_an_archive_hold_whatever_it_declares(client, run, monkeypatch):
    monkeypatch.setattr(uploads, "MOST_UNPACKED", 50_000)
    bomb = bytearray(packed({"a.csv": b"0" * 60_000}, compression=zipfile.ZIP_DEFLATED))
    assert len(bomb) < 1_000
    assert "too large" in refusal(client.put(f"/api/runs/{run.id}/recordings/x.zip", content=bytes(bomb)))
    good = packed({f"{i}.csv": b"0" * 10_000 for i in range(5)}, compression=zipfile.ZIP_DEFLATED)
    assert client.put(f"/api/runs/{run.id}/recordings/good.zip", content=good).status_code == 201
    monkeypatch.setattr("simgap.app.runs.MOST_FILES", 8)
    assert "at most 3 more" in refusal(client.put(f"/api/runs/{run.id}/recordings/x.zip", content=good))
    assert len(again(run).recordings) == 5


def test_the_main_model_of_several_files(tmp_path):
    for name, text in (
        ("a.xml", ARM),
        ("parts/link.xml", LINK),
        ("b/scene.xml", '<mujoco><!-- <include file="../a.xml"/> --></mujoco>'),
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert main_model(tmp_path, ["a.xml", "parts/link.xml"]) == "a.xml"
    assert main_model(tmp_path, ["a.xml", "b/scene.xml", "parts/link.xml"]) == ""
    assert main_model(tmp_path, ["a.stl"]) == ""
