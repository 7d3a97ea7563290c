"""Sites: a joint and a side, and the place strings that are their aliases."""

from __future__ import annotations

import pytest
from mjcf_chains import Spec, chain_xml

from mjsim.effects import NotApplicableError, registered
from mjsim.effects.backlash import Backlash
from mjsim.effects.coulomb_friction import CoulombFriction
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.site import Side, Site


@pytest.fixture(params=[1, 2, 3, 4, 5])
def chain(request, tmp_path):
    n = request.param
    (tmp_path / "own.xml").write_text(
        chain_xml(Spec((1.0,) * n, 1.0, (1e3,) * (n - 1), (1.0,) * (n - 1), 0.5, "hinge", "nested", 1.0))
    )
    return load_axis(tmp_path / "own.xml").chain


def test_every_site_has_a_place_and_every_place_its_site(chain):
    assert len(set(chain.sites())) == len(chain.sites()) == 2 * len(chain.bodies) + 1
    for site in chain.sites():
        place = chain.place(site)
        if place.startswith("body"):
            continue  # effects know no place between the second and the last body
        back = chain.site(place, coupling=site.side is Side.COUPLING)
        assert back == site


def test_a_site_of_another_chain_names_the_choices(chain):
    with pytest.raises(KeyError, match="elbow/motor"):
        chain.place(Site("elbow", Side.MOTOR))


def test_text_round_trip():
    site = Site("shoulder/left", Side.COUPLING)
    assert Site.parse(str(site)) == site
    for text in ("shoulder", "shoulder/up", "/motor", ""):
        with pytest.raises(ValueError, match="coupling"):
            Site.parse(text)


def test_effects_act_at_sites():
    axis = load_axis(shipped_model("robot_axis1"))
    friction, gap = CoulombFriction(place="gearbox", torque_Nm=1.0), Backlash(gap_rad=1e-4)
    axis = axis + friction + gap
    assert {str(e.site(axis.chain)) for e in axis.effects} == {
        f"{axis.chain.bodies[1].joint}/link", f"{axis.chain.couplings[0].joint}/coupling"
    }  # fmt: skip
    assert axis.at(friction.site(axis.chain)) == (friction,)
    assert axis.at(Site(axis.chain.bodies[0].joint, Side.SENSOR)) == ()
    with pytest.raises(NotApplicableError):
        Backlash(gap_rad=1e-4).site(load_axis(shipped_model("emps")).chain)


def test_places_of_effects_are_places_of_the_robot_axis():
    chain = load_axis(shipped_model("robot_axis1")).chain
    for cls in registered().values():
        assert set(cls.places) <= {chain.place(s) for s in chain.sites()}
