"""The page of the ablation says what its data say."""

from __future__ import annotations

import json
from pathlib import Path

from lab.panel.ablation_page import DATA, page

PAGE = Path(__file__).parents[2] / "docs" / "decisions" / "ablation.md"


def test_the_page_is_that_of_its_data():
    assert PAGE.read_text(encoding="utf-8") == page(json.loads(DATA.read_text(encoding="utf-8")))
