"""`lab.fuzz`, `lab.kill` and the audit: what they start from is valid, and what they look for is noticed."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest

from lab.fuzz.corpus import SEEDS
from lab.fuzz.targets import TARGETS
from lab.fuzz.worker import Counter
from lab.kill import contents, differences
from mjsim.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
NEEDS = {"hdf5": "h5py", "parquet": "pyarrow", "mcap": "mcap"}


@pytest.mark.parametrize("reader", TARGETS)
def test_files_that_mutation_starts_from_are_valid(reader, tmp_path):
    pytest.importorskip(NEEDS.get(reader, "numpy"))
    path = tmp_path / f"log{TARGETS[reader].suffix}"
    seeds = SEEDS[reader]()
    assert seeds
    for data in seeds:
        path.write_bytes(data)
        TARGETS[reader].read(path)


def test_a_find_is_kept_and_counted_once(tmp_path):
    counter = Counter("ledger", TARGETS["ledger"], tmp_path / "told.json", tmp_path, tmp_path)

    def read(path: Path) -> None:
        match path.read_bytes():
            case b"good":
                return
            case b"bad":
                raise InputError("log", "bad")
        raise KeyError("x")

    object.__setattr__(counter, "_target", type(TARGETS["ledger"])(".jsonl", read))
    for data in (b"good", b"bad", b"worse", b"worst"):
        counter(data)
    counter.write()
    told = json.loads((tmp_path / "told.json").read_text())
    assert (told["valid"], told["refused"], len(told["finds"])) == (1, 1, 1)
    assert [p.read_bytes() for p in tmp_path.glob("ledger-*")] == [b"worse"]


def test_what_a_killed_command_left_is_compared(tmp_path):
    (tmp_path / "diagnosis.json").write_text('{"seconds": 3.25, "a": 1}')
    (tmp_path / ".report.html.part").write_text("half")
    (tmp_path / "state.jsonl").write_text("{}")
    reference = contents(tmp_path) | {"report.html": b"<html>"}
    (tmp_path / "diagnosis.json").write_text('{"seconds": 1e-3, "a": 1}')
    assert differences(contents(tmp_path), reference, whole=False) == []
    assert differences(contents(tmp_path), reference, whole=True) == ["report.html: missing"]
    (tmp_path / "diagnosis.json").write_text('{"seconds": 3.25, "a"')
    assert differences(contents(tmp_path), reference, whole=False) == ["diagnosis.json: other bytes"]


@pytest.mark.parametrize(
    ("said", "code", "told"),
    [
        ("", 0, "not audited"),
        ('{"dependencies": [{"name": "a", "skip_reason": "unknown"}]}', 0, "not audited"),
        ('{"dependencies": [{"name": "a", "version": "1", "vulns": []}]}', 0, "1 of 1 packages audited, 0 vulnerabilities"),
        ('{"dependencies": [{"name": "a", "version": "1", "vulns": [{"id": "CVE-1"}]}]}', 1, "a 1: CVE-1"),
    ],
)
def test_the_audit(said, code, told):
    spec = importlib.util.spec_from_file_location("audit", ROOT / ".ci" / "audit.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    ended, text = module.judged(said)
    assert ended == code
    assert told in text
