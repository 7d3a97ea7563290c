"""Trees and editors of MJCF are freed with their last user, and do not wait for the garbage collector."""

from __future__ import annotations

import gc
import weakref

import pytest

from mjsim.axis import Axis
from mjsim.mjcf import load_axis, write_corrected
from mjsim.mjcf.editor import MjcfEditor
from mjsim.mjcf.native_write import NativeWriter
from mjsim.mjcf.xmltext import XmlText
from mjsim.models import shipped_model


@pytest.fixture
def no_collector():
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def test_a_tree_goes_with_its_text(no_collector):
    text = XmlText("<a><b><c x='1'/></b></a>")
    inner = text.find(lambda n: n.tag == "c")
    assert inner.parent.tag == "b"
    assert inner.parent.parent.parent is None
    gone = [weakref.ref(n) for n in text.root.walk()]
    del text, inner
    assert [r() for r in gone] == [None, None, None]


def test_a_corrected_file_leaves_nothing_behind(no_collector, tmp_path, monkeypatch):
    """What writes a file is freed as the call returns: 100 such calls of a diagnosis kept megabytes until a full collection."""
    made: list[weakref.ref[object]] = []
    for kind in (MjcfEditor, NativeWriter, XmlText):

        def init(self, *words, __init=kind.__init__, **more):
            made.append(weakref.ref(self))
            __init(self, *words, **more)

        monkeypatch.setattr(kind, "__init__", init)
    model = shipped_model("pendulum")
    axis: Axis = load_axis(model)
    write_corrected(model, axis, tmp_path / "corrected.xml")
    assert len(made) >= 3
    assert [r() for r in made if r() is not None] == []
