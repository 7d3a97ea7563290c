"""Ablation: what is switched off comes back, names that are gone are refused, and every rule fits the code."""

from __future__ import annotations

import sys
from types import ModuleType

import pytest

from lab.panel.driver import resolve, switched_off, watched
from lab.panel.rules import RULES, rules_of
from mjsim.errors import InputError


class Thing:
    """A class with two methods."""

    def same(self, x, y):
        return x + y

    def listed(self):
        return [1]


@pytest.fixture
def module(monkeypatch):
    m = ModuleType("panel_probe")
    m.LIMIT, m.Thing, m.work = 5, Thing, lambda a, b: a * b
    monkeypatch.setitem(sys.modules, "panel_probe", m)
    return m


def test_constants_functions_and_methods_are_replaced_and_come_back(module):
    kept = module.LIMIT, module.work, vars(Thing)["same"], vars(Thing)["listed"]
    patches = [
        {"target": "panel_probe.LIMIT", "value": 9}, {"target": "panel_probe.work", "argument": [0, 1]},
        {"target": "panel_probe.Thing.same", "argument": 2}, {"target": "panel_probe.Thing.listed", "returns": []},
    ]  # fmt: skip
    with switched_off(patches):
        assert module.LIMIT == 9
        assert module.work(2, 3) == (2, 3)
        assert Thing().same(1, 7) == 7
        Thing().listed().append(1)
        assert Thing().listed() == []
    assert (module.LIMIT, module.work, vars(Thing)["same"], vars(Thing)["listed"]) == kept


def test_acts_of_rules_are_counted_and_nothing_else_changes(module):
    module.NOTHING, module.judged = object(), None
    module.judged = lambda x: module.NOTHING if x else x
    kept = module.work, vars(Thing)["listed"], module.judged
    counts: dict[str, int] = {}
    rules = {
        "work": [{"target": "panel_probe.work", "argument": 0}],
        "listed": [{"target": "panel_probe.Thing.listed", "returns": []}],
        "judged": [{"target": "panel_probe.judged", "named": "panel_probe.NOTHING"}],
        "limit": [{"target": "panel_probe.LIMIT", "value": 9}],
    }  # fmt: skip
    with watched(rules, counts):
        assert [module.work(a, 2) for a in (3, 0)] == [6, 0]  # the second is the argument itself
        assert Thing().listed() == [1]
        assert (module.judged(1), module.judged(0)) == (module.NOTHING, 0)
        assert module.LIMIT == 5
    assert counts == {"work": 1, "listed": 1, "judged": 1}
    assert (module.work, vars(Thing)["listed"], module.judged) == kept


def test_everything_comes_back_after_an_error(module):
    with pytest.raises(ZeroDivisionError), switched_off([{"target": "panel_probe.LIMIT", "value": 9}]):
        _ = 1 / 0
    assert module.LIMIT == 5


@pytest.mark.parametrize(
    "patch",
    [
        {"target": "panel_probe.GONE", "value": 1},
        {"target": "panel_probe.Thing.gone", "returns": None},
        {"target": "panel_probe.Gone.same", "returns": None},
        {"target": "no_such_module.name", "value": 1},
        {"target": "panel_probe.LIMIT", "returns": None},
        {"target": "panel_probe.work", "value": 1},
    ],
)
def test_a_name_that_is_gone_or_of_another_kind_is_refused(module, patch):
    with pytest.raises(LookupError), switched_off([{"target": "panel_probe.LIMIT", "value": 9}, patch]):
        pass
    assert module.LIMIT == 5


def test_an_inherited_method_is_not_found_under_its_heir(module):
    module.Heir = type("Heir", (Thing,), {})
    with pytest.raises(LookupError):
        resolve("panel_probe.Heir.same")


@pytest.mark.parametrize("name", RULES)
def test_every_rule_fits_the_code(name):
    with switched_off(RULES[name].patches):
        pass


def test_rules_are_named_by_the_table():
    assert [r.name for r in rules_of(("confounders", "decimation"))] == ["confounders", "decimation"]
    with pytest.raises(InputError, match="decimation"):
        rules_of(("no_such_rule",))
