"""What refused a leading rival is told with its figures."""

from __future__ import annotations

from diagnose.result import Refused
from diagnose.verdict.refusals import refused_in_words

HELD = {"relative_gain": 0.51, "needed": 0.02, "p_value": 0.0551, "largest_p_value": 0.02}


def test_a_refusal_names_test_and_figures():
    (said,) = refused_in_words([Refused(("presliding_friction@motor",), (), "held_out", HELD)])
    assert said == (
        "Presliding friction at the motor is refused: it changes the held-out squared error by -51.0% with p = 0.055 "
        "(needed: -2.00%, p below 0.02)."
    )
    two = ("backlash@gearbox", "coulomb_friction@arm")
    (said,) = refused_in_words([Refused(two, ("backlash@gearbox",), "events", {"gain": 3.0, "needed": 25.0})])
    assert said.startswith(
        "Backlash at the gearbox and coulomb friction at the arm is refused: it gains by the moment of an event"
    )


def test_the_criterion_alone_is_no_refusal_and_three_are_enough():
    plain = Refused(("static_friction@motor",), (), "criterion", {"gain": -5.0, "needed": 0.5})
    servo = Refused(("time_delay@sensor",), (), "servo", {"share": 0.15, "needed": 0.5})
    assert refused_in_words([plain]) == ()
    assert len(refused_in_words([plain, *[servo] * 5])) == 3
