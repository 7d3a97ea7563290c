"""Progress where lines stay: of one stage and the same best no more than one line in a while."""

from __future__ import annotations

from diagnose.progress import Step
from simgap.following import following


def test_compiling_beside_the_search_is_told_once_in_a_while(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("simgap.following.time.monotonic", lambda: now[0])
    with following(True) as tell:
        for k in range(40):  # 40 functions within 20 s, while the search goes on
            now[0] = 0.5 * k
            tell(Step("compile", f"the simulation: {k} functions so far"))
            tell(Step("search", "add to the nominal model"))
    said = capsys.readouterr().err.splitlines()
    assert [line.split()[3] for line in said] == ["compile:", "search:", "compile:", "search:"]
