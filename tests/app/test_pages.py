"""What the pages of the app show: names and units of the signals of a recording, texts of commands."""

from __future__ import annotations

import pytest

pytest.importorskip("starlette", reason="starlette is not installed: pip install simgap[app]")


def test_signals_of_a_slide_are_positions_and_forces():
    import numpy as np

    from mjsim.recording import Recording
    from simgap.app.preview import signals_chart

    t = np.arange(3.0)
    slide = signals_chart(Recording(t, t, None, t, 1.0, source="a", units={"torque": "", "angle": "m"}))
    assert [(p.y.name, p.y.unit) for (p,) in slide.rows] == [("force", "N"), ("position", "m")]
    unknown = signals_chart(Recording(t, t, t, None, 1.0, source="a", units={}))
    assert [(p.y.name, p.y.unit) for (p,) in unknown.rows] == [("torque", ""), ("velocity", "")]


def test_the_text_of_a_command_has_its_code_marked_and_the_rest_escaped():
    from simgap.app.pages import _environment

    text = _environment().from_string("{{ text|code }}").render(text="the effects that `a <b>` & others")
    assert text == "the effects that <code>a &lt;b&gt;</code> &amp; others"
