"""The app's routes: token, host and origin, limits, paths that lead out, bad input, answers of a command."""

from __future__ import annotations

import json
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="starlette is not installed: pip install simgap[app]")
pytest.importorskip("httpx2", reason="httpx2 is not installed: pip install simgap[dev]")

from starlette.testclient import TestClient

from simgap.app.guard import POLICY, WRITTEN_POLICY
from simgap.app.jobs import _keep
from simgap.app.preview import Previews
from simgap.app.record import begin, end
from simgap.app.runs import Runs, Settings
from simgap.app.server import make_app

TOKEN, PORT, MOST = "right", 8123, 2_000_000
MODEL = (Path(__file__).resolve().parents[2] / "models" / "pendulum.xml").read_bytes()


@pytest.fixture
def client(tmp_path):
    """Of a server whose process for pictures starts with the first one."""
    app = make_app(tmp_path / "runs", TOKEN, PORT, MOST)
    with ExitStack() as stack:
        with pytest.MonkeyPatch.context() as starting:
            starting.setattr(Previews, "start", lambda self: None)
            client = stack.enter_context(TestClient(app, base_url=f"http://127.0.0.1:{PORT}", raise_server_exceptions=True))
        client.cookies.set(f"simgap-{PORT}", TOKEN)
        yield client


@pytest.fixture
def run(client):
    return client.post("/api/runs", json={"name": "first"}).json()["id"]


def error(answer, status=400):
    assert answer.status_code == status, answer.text
    text = answer.json()["error"]
    assert len(text.splitlines()) == 1
    return text


def ended(client, run, seconds=120):
    """Wait for the command of a run; the lines that it said."""
    with client.stream("GET", f"/api/runs/{run}/events", timeout=seconds) as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        events = "".join(answer.iter_text()).split("\n\n")
    assert events[-2] == "event: ended\ndata: null"
    return [json.loads(e.removeprefix("data: ")) for e in events[:-2]]


ROUTES = [
    ("GET", "/"), ("GET", "/compare"), ("GET", "/runs/x"), ("GET", "/files/x/diagnose/report.html"), ("GET", "/runs/x/run"),
    ("GET", "/api/runs/x/picture/a.csv"), ("GET", "/static/app.js"),
    ("GET", "/static/app.css"), ("POST", "/api/runs"), ("DELETE", "/api/runs/x"), ("POST", "/api/runs/x/start"),
    ("GET", "/api/runs/x/events"), ("PUT", "/api/runs/x/model/a.xml"), ("GET", "/nowhere"),
]  # fmt: skip


@pytest.mark.parametrize(("method", "path"), ROUTES)
@pytest.mark.parametrize("token", ["", "wrong", "rightx", "ü"])
def test_without_the_token_nothing_is_answered(client, tmp_path, method, path, token):
    client.cookies.clear()
    answer = client.request(method, path, params={"token": token}, headers={"cookie": "simgap-8123=wrong"})
    assert answer.status_code == 403
    assert len(answer.text.splitlines()) == 1
    assert list((tmp_path / "runs").iterdir()) == []


def test_the_token_in_the_address_becomes_a_cookie(client):
    client.cookies.clear()
    answer = client.get("/compare", params={"token": TOKEN, "run": "a b"}, follow_redirects=False)
    assert answer.status_code == 303
    assert answer.headers["location"] == "/compare?run=a+b"
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert client.get("/").status_code == 200
    client.cookies.clear()
    assert (
        client.get(f"http://127.0.0.1:{PORT}//example.org/", params={"token": TOKEN}, follow_redirects=False).headers["location"]
        == "/example.org/"
    )


@pytest.mark.parametrize(
    "host", ["example.org", f"example.org:{PORT}", "127.0.0.1", f"127.0.0.1:{PORT + 1}", "", "127.0.0.1.nip.io"]
)
def test_another_host_is_refused(client, host):
    assert client.get("/", headers={"host": host}).status_code == 400
    assert client.get("/", headers={"host": f"localhost:{PORT}"}).status_code == 200


@pytest.mark.parametrize("origin", ["null", "http://example.org", f"http://127.0.0.1:{PORT + 1}", f"https://127.0.0.1:{PORT}"])
def test_a_change_from_another_origin_is_refused(client, tmp_path, origin):
    assert client.post("/api/runs", json={}, headers={"origin": origin}).status_code == 403
    assert list((tmp_path / "runs").iterdir()) == []
    assert client.post("/api/runs", json={}, headers={"origin": f"http://127.0.0.1:{PORT}"}).status_code == 201


def test_every_answer_has_a_policy(client, run):
    for path in (
        "/",
        f"/runs/{run}",
        "/compare",
        "/static/app.js",
        f"/runs/{run}/render",
        "/nowhere",
        f"/files/{run}/diagnose/report.html",
    ):
        answer = client.get(path)
        assert answer.headers["content-security-policy"] == POLICY
        assert answer.headers["x-content-type-options"] == "nosniff"
    assert "unsafe" not in POLICY
    page = client.get(f"/runs/{run}").text
    assert "style=" not in page
    assert "<script>" not in page
    assert " onclick" not in page
    assert "http://" not in page
    assert "https://" not in page


def test_an_upload_is_kept_under_a_safe_name(client, run, tmp_path):
    folder = tmp_path / "runs" / run
    assert client.put(f"/api/runs/{run}/model/pendulum.xml", content=MODEL).json() == {"name": "pendulum.xml"}
    assert (folder / "model" / "pendulum.xml").read_bytes() == MODEL
    assert Runs(tmp_path / "runs").get(run).settings.model == "model/pendulum.xml"
    for given, kept in [("a.csv", "a.csv"), ("..%5Cb.csv", "b.csv"), (".c.csv", "c.csv"), ("-d e.CSV", "d_e.CSV"),
                        ("%C3%BC%3Cb%3E.csv", "__b_.csv")]:  # fmt: skip
        assert client.put(f"/api/runs/{run}/recordings/{given}", content=b"x").json() == {"name": kept}
        assert (folder / "recordings" / kept).is_file()
    error(client.put(f"/api/runs/{run}/recordings/..%2F..%2Fa.csv", content=b"x"))
    assert {p.name for p in (tmp_path / "runs").iterdir()} == {run}
    assert {p.name for p in tmp_path.iterdir()} == {"runs"}
    assert client.delete(f"/api/runs/{run}/recordings/a.csv").status_code == 200
    error(client.delete(f"/api/runs/{run}/recordings/a.csv"), 404)
    assert client.delete(f"/api/runs/{run}/model/pendulum.xml").status_code == 200
    assert Runs(tmp_path / "runs").get(run).settings.model == ""


@pytest.mark.parametrize("name", ["a.py", "a.exe", "run.json", "a", "a.csv.html"])
def test_other_kinds_of_files_are_refused(client, run, name):
    assert "not read here" in error(client.put(f"/api/runs/{run}/recordings/{name}", content=b"x"))
    error(client.put(f"/api/runs/{run}/out/report.html", content=b"x"), 404)


@pytest.mark.parametrize("declared", [True, False])
def test_the_limit_of_an_upload(client, run, tmp_path, declared):
    def body(size):
        return b"x" * size if declared else iter([b"x" * (size // 2), b"x" * (size - size // 2)])

    assert client.put(f"/api/runs/{run}/recordings/a.csv", content=body(MOST)).status_code == 201
    text = error(client.put(f"/api/runs/{run}/recordings/b.csv", content=body(MOST + 1)), 413)
    assert "too large" in text
    assert [p.name for p in (tmp_path / "runs" / run / "recordings").iterdir()] == ["a.csv"]
    assert error(client.post("/api/runs", content=b"[" * 70_000), 413)


@pytest.mark.parametrize("body", [b"{", b"[]", b"[" * 60_000, b"\xff", b"1"])
def test_a_body_that_is_no_object_is_refused(client, run, body):
    error(client.post(f"/api/runs/{run}/settings", content=body))


ELSEWHERE = (
    "/files/{run}/run.json", "/files/{run}/check/..%2F..%2Frun.json", "/files/{run}/check/../../run.json", "/runs/..%2F..",
    "/files/{run}/diagnose/state.jsonl", "/files/{run}/../report.html", "/files/..%2F..%2F{run}/check/check.html",
    "/runs/{run}/app", "/runs/{run}/rm", "/api/runs/{run}/picture/..%2Frun.json", "/api/runs/{run}/picture/a.csv",
    "/runs/20260101-000000-abcdef", "/static/server.py",
    "/static/..%2Fserver.py", "/compare?run=..",
)  # fmt: skip


@pytest.mark.parametrize("path", ELSEWHERE)
def test_paths_that_lead_elsewhere_are_not_there(client, run, path):
    assert client.get(path.format(run=run)).status_code == 404


@pytest.mark.parametrize(("new", "told"), [
    ({"modle": "emps"}, "did you mean 'model'?"), ({"model": "emp"}, "did you mean 'emps'?"),
    ({"model": "../a.xml"}, "not there"), ({"model": "model/none.xml"}, "not there"), ({"model": 3}, "no short text"),
    ({"held_out": "a"}, "no list"), ({"values": []}, "an object"), ({"values": {"diagnose": 1}}, "an object of fields"),
    ({"values": {"diagnos": {}}}, "did you mean 'diagnose'?"), ({"values": {"app": {"port": 1}}}, "unknown"),
    ({"values": {"diagnose": {"effort": -1}}}, "at least 0"), ({"values": {"diagnose": {"effort": True}}}, "a number"),
    ({"values": {"diagnose": {"effort": 1e400}}}, "a number"), ({"values": {"diagnose": {"seed": 1.5}}}, "whole"),
    ({"values": {"diagnose": {"judge": "x"}}}, "motion, force"), ({"values": {"diagnose": {"film": "yes"}}}, "true or false"),
    ({"values": {"diagnose": {"effects": "a\nb"}}}, "printable"), ({"values": {"diagnose": {"out": "elsewhere"}}}, "unknown"),
    ({"values": {"replay": {"format": ".py"}}}, ".csv, .parquet"),
])  # fmt: skip
def test_bad_settings_are_told(client, run, tmp_path, new, told):
    assert told in error(client.post(f"/api/runs/{run}/settings", content=json.dumps(new)))
    assert Runs(tmp_path / "runs").get(run).settings == Settings()


def test_a_start_without_what_it_needs_is_told(client, run):
    start = f"/api/runs/{run}/start"
    assert "unknown" in error(client.post(start, json={"command": "rm"}))
    assert "unknown" in error(client.post(start, json={"command": "app"}))
    assert "step 1" in error(client.post(start, json={"command": "check"}))
    client.post(f"/api/runs/{run}/settings", json={"model": "pendulum"})
    assert "step 2" in error(client.post(start, json={"command": "check"}))
    client.put(f"/api/runs/{run}/recordings/a.csv", content=b"x")
    client.post(f"/api/runs/{run}/settings", json={"held_out": ["a.csv"]})
    assert "held out" in error(client.post(start, json={"command": "diagnose"}))


def test_no_setting_becomes_an_option(client, run, tmp_path):
    client.put(f"/api/runs/{run}/recordings/--out=x.csv", content=b"x")
    values = {"diagnose": {"effects": "--json", "joints": "--film, a"}, "effects": {"name": "--help"}}
    client.post(f"/api/runs/{run}/settings", json={"model": "pendulum", "values": values})
    words = Runs(tmp_path / "runs").get(run).words("diagnose")
    assert "recordings/out_x.csv" in words
    assert {"--effects=--json", "--joint=--film", "--joint=a"} <= set(words)
    assert not {"--json", "--film"} & set(words)
    assert Runs(tmp_path / "runs").get(run).words("effects") == ["effects", "--", "--help"]


def test_the_baseline_of_a_gate_is_the_diagnosis_of_the_run(client, run, tmp_path):
    client.put(f"/api/runs/{run}/recordings/a.csv", content=b"x")
    client.post(f"/api/runs/{run}/settings", json={"model": "pendulum"})
    assert "nothing is given" in error(client.post(f"/api/runs/{run}/start", json={"command": "gate"}))
    for name in ("check/check.json", "diagnose/diagnosis.json"):
        path = tmp_path / "runs" / run / "out" / name
        path.parent.mkdir(parents=True)
        path.write_text("{}")
    words = Runs(tmp_path / "runs").get(run).words("gate")
    assert "--baseline=out/diagnose/diagnosis.json" in words
    assert words[-3:] == ["--", "pendulum", "recordings/a.csv"]


def test_a_file_outside_of_the_run_is_refused(client, run):
    client.put(f"/api/runs/{run}/recordings/a.csv", content=b"x")
    for name, value in (("recording", "/etc/passwd"), ("recording", "recordings/../run.json"), ("model", "../a.xml")):
        client.post(f"/api/runs/{run}/settings", json={"model": "pendulum", "values": {"replay": {name: value}}})
        assert "is not there" in error(client.post(f"/api/runs/{run}/start", json={"command": "replay"}))
        client.post(f"/api/runs/{run}/settings", json={"values": {"replay": {name: ""}}})
    client.post(f"/api/runs/{run}/settings", json={"values": {"render": {"source": "/etc/passwd"}}})
    assert "is not there" in error(client.post(f"/api/runs/{run}/start", json={"command": "render"}))


@pytest.mark.slow
def test_a_wrong_recording_is_told_in_one_line_of_the_page(client, run):
    client.post(f"/api/runs/{run}/settings", json={"model": "pendulum"})
    client.put(f"/api/runs/{run}/recordings/a.csv", content=b"<b>,y\n1,2\n")
    assert client.post(f"/api/runs/{run}/start", json={"command": "check"}).status_code == 202
    assert "works already" in error(client.post(f"/api/runs/{run}/start", json={"command": "check"}))
    assert "works" in error(client.put(f"/api/runs/{run}/recordings/b.csv", content=b"x"))
    assert "works" in error(client.delete(f"/api/runs/{run}"))
    lines = ended(client, run)
    assert len(lines) == 1
    page = client.get(f"/runs/{run}").text
    assert 'class="alarm error"' in page
    assert "recordings/a.csv" in page
    assert "<b>" not in page


def test_uploaded_code_is_not_imported(client, run, tmp_path):
    """A module of the run's folder would come before the installed one without -P."""
    folder = tmp_path / "runs" / run
    (folder / "numpy.py").write_text("import pathlib; pathlib.Path('ran').touch()")
    (folder / "simgap.py").write_text("import pathlib; pathlib.Path('ran').touch()")
    client.post(f"/api/runs/{run}/settings", json={"model": "pendulum"})
    client.put(f"/api/runs/{run}/recordings/a.csv", content=b"t\n1\n")
    client.post(f"/api/runs/{run}/start", json={"command": "check"})
    assert "a.csv" in ended(client, run)[-1]
    assert not (folder / "ran").exists()


def test_from_upload_to_the_check_and_back_after_a_restart(client, run, log, tmp_path):
    client.put(f"/api/runs/{run}/model/pendulum.xml", content=MODEL)
    client.put(f"/api/runs/{run}/recordings/a.csv", content=log)
    client.post(f"/api/runs/{run}/start", json={"command": "check"})
    ended(client, run)
    with TestClient(make_app(tmp_path / "runs", TOKEN, PORT), base_url=f"http://127.0.0.1:{PORT}") as again:
        again.cookies.set(f"simgap-{PORT}", TOKEN)
        assert "Ready" in again.get(f"/runs/{run}").text
        answer = again.get(f"/files/{run}/check/check.html")
        assert answer.headers["content-security-policy"] == WRITTEN_POLICY
        assert again.get(f"/files/{run}/check/check.json").json()["verdict"] == "ready"
        assert "attachment" in again.get(f"/files/{run}/check/check.json").headers["content-disposition"]
        other = again.post(f"/api/runs/{run}/copy", json={}).json()["id"]
        assert Runs(tmp_path / "runs").get(other).recordings == ["a.csv"]
        again.put(f"/api/runs/{run}/recordings/b.csv", content=log)
        assert again.get(f"/files/{run}/check/check.json").status_code == 200
        assert "have changed since" in again.get(f"/runs/{run}").text
        assert again.delete(f"/api/runs/{run}").status_code == 200
        assert [r.id for r in Runs(tmp_path / "runs").all()] == [other]


@pytest.mark.slow
def test_a_wrong_log_is_an_answer_of_the_check(client, run, log):
    head, *rows = log.decode().splitlines()
    turned = "\n".join([head, *(",".join([a, b, str(-float(c))]) for a, b, c in (r.split(",") for r in rows))])
    client.post(f"/api/runs/{run}/settings", json={"model": "pendulum"})
    client.put(f"/api/runs/{run}/recordings/a.csv", content=turned.encode())
    client.post(f"/api/runs/{run}/start", json={"command": "check"})
    ended(client, run)
    page = client.get(f"/runs/{run}").text
    assert "Fix first" in page
    assert 'class="alarm error"' not in page


def test_a_stopped_command_and_one_that_a_server_left(client, run, log, tmp_path):
    client.post(f"/api/runs/{run}/settings", json={"model": "pendulum", "values": {"diagnose": {"effort": 0}}})
    client.put(f"/api/runs/{run}/recordings/a.csv", content=log)
    client.post(f"/api/runs/{run}/start", json={"command": "diagnose"})
    client.post(f"/api/runs/{run}/stop")
    ended(client, run)
    assert "stopped; starting again" in client.get(f"/runs/{run}").text
    kept = Runs(tmp_path / "runs").get(run)
    assert "--effort=0.0" in kept.words("diagnose")
    begin(kept, "diagnose", kept.words("diagnose"))
    assert "broken off with the server" in client.get(f"/runs/{run}").text
    assert client.get("/").status_code == 200


def test_a_run_of_another_version_does_not_hide_the_others(client, run, tmp_path):
    (tmp_path / "runs" / run / "run.json").write_text('{"name": "<i>old</i>", "settings": {"unknown": 1}}')
    page = client.get("/").text
    assert "&lt;i&gt;old" in page
    assert client.get(f"/compare?run={run}").status_code == 200


def test_lines_are_bounded_and_the_last_is_kept(monkeypatch):
    monkeypatch.setattr("simgap.app.jobs.MOST_LINES", 3)
    lines: list[str] = []
    _keep(iter(f"{i}\x1b\n" for i in range(9)), lines)  # type: ignore[arg-type]
    assert lines == ["0\\x1b", "1\\x1b", "8\\x1b"]


def test_a_missing_extra_is_one_line(monkeypatch, capsys, tmp_path):
    from simgap import cli

    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    monkeypatch.setattr(sys, "argv", ["simgap", "app", "--no-browser"])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    assert stopped.value.code == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert "pip install 'simgap[app]'" in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_picture_of_a_recording_or_why_there_is_none(client, run, log):
    client.put(f"/api/runs/{run}/recordings/a.csv", content=log)
    client.put(f"/api/runs/{run}/recordings/b.csv", content=b"<b>,y\n1,2\n")
    picture = f"/api/runs/{run}/picture/"
    assert client.get(picture + "a.csv").json()["svg"].startswith("<svg ")
    told = client.get(picture + "b.csv").json()
    assert told["svg"] == ""
    assert told["problem"].startswith("recordings/b.csv")
    client.post(f"/api/runs/{run}/settings", json={"model": "pendulum"})
    assert "velocity" in client.get(picture + "a.csv").json()["svg"]


def test_how_a_command_ended_is_shown(client, run, tmp_path):
    """Exit code 1 is a result, with the line that it ended with; 2 is a refusal; neither hides what was printed."""
    kept = Runs(tmp_path / "runs").get(run)
    for code, colour, shown in ((0, "", True), (1, "warn", True), (2, "alarm", False)):
        begin(kept, "gate", ["gate"]).write_text("a table", encoding="utf-8")
        end(kept, "gate", code, stopped=False, lines=["working", "simgap: the error <grew>"])
        page = client.get(f"/runs/{run}/gate").text
        assert ("a table" in page) == shown
        assert (f'class="{colour} error"' in page) == bool(code)
        assert ("the error &lt;grew&gt;" in page) == bool(code)


def test_the_server_does_not_wait_for_a_picture_when_it_ends(tmp_path, monkeypatch):
    import os
    import threading
    import time

    from simgap.app import preview

    monkeypatch.setattr(preview, "PATIENCE", 60.0)
    os.mkfifo(tmp_path / "a.csv")  # a reader would wait for it
    previews = preview.Previews()
    previews.start()
    told = []
    waiting = threading.Thread(target=lambda: told.append(previews.picture(tmp_path, "a.csv", "")))
    waiting.start()
    time.sleep(0.2)
    previews.close()
    waiting.join(10.0)
    assert not waiting.is_alive()
    assert len(told) == 1
