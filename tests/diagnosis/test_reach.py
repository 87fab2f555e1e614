"""How far a parameter may be from where it was found: led there, and not only what slopes say."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from test_onset import PLANE
from test_parts_of_a_diagnosis import base, measured, resolved

from stringcast.stages.diagnose.fit import fitted
from stringcast.stages.diagnose.hypotheses import Hypotheses
from stringcast.stages.diagnose.reach import AGAINST, reach
from stringcast.stages.diagnose.theory import joined
from stringcast.stages.diagnose.verdict import log_odds
from stringcast.stages.model.library import library

HARD = "contact.stiffness"


@pytest.fixture(scope="module")
def model(arm):
    return resolved(ordinary(arm))


def weighed(model, evidence, *fits):
    """As a diagnosis keeps them."""
    hypotheses = Hypotheses(evidence, evidence, evidence, model, library(), 0)
    for fit in fits:
        hypotheses.add(fit)
    return hypotheses


def led(evidence, fit, name, chi):
    """The fit of all others with one parameter held."""
    theory, start = replace(fit.theory, held=frozenset({name})), fit.chi.copy()
    start[theory.model.names.index(name)] = chi
    return fitted(evidence, [theory], [start], 8)[0]


def deviation(fit, name):
    """Standard deviation of an exponent as slopes at the fit have it."""
    place = list(fit.theory.free).index(fit.theory.model.names.index(name))
    return np.sqrt(np.linalg.inv(fit.normal)[place, place])


def test_where_cost_is_a_parabola_it_is_as_far_as_its_curvature_says(arm, model):
    """The 1.96 standard deviations of 95 %, and as much more as few pieces of time and an inexact model allow."""
    evidence = measured(arm, model, {"tip_mass.ratio": 0.02})
    plain, name = base(model, evidence), "tip_mass.ratio"
    theory = joined(plain.theory, library()["tip_mass"])
    fit = fitted(evidence, [theory], [theory.at({**TRUTH, name: 0.02})], 15)[0]
    hypotheses, sure = weighed(model, evidence, plain, fit), deviation(fit, name)
    (ends,) = reach(hypotheses, fit, library()["tip_mass"]).values()
    found = fit.chi[theory.model.names.index(name)]
    for end in ends:
        there, beyond = (led(evidence, fit, name, x) for x in (end, end + np.sign(end - found) * sure))
        assert there.cost - fit.cost == pytest.approx(((end - found) / sure) ** 2 / 2, rel=0.1)
        assert log_odds(hypotheses, beyond, fit) < -AGAINST < log_odds(hypotheses, there, fit)
        assert 1.96 <= abs(end - found) / sure < 4


@pytest.fixture(scope="module")
def grazed(arm, model):
    """A plane that was found: its fit, how far it may be, and from where the others followed when
    its hardness was led away."""
    evidence, asked = measured(arm, model, PLANE, seconds=0.9), []
    plain = base(model, evidence)
    theory = joined(plain.theory, library()["contact"])
    fit = fitted(evidence, [theory], [theory.at({**TRUTH, **PLANE, "contact.stiffness": 1e6})], 15)[0]

    def noted(evidence, theories, starts, most):
        asked.extend(start for theory, start in zip(theories, starts, strict=True) if HARD in theory.held)
        return fitted(evidence, theories, starts, most)

    hypotheses = weighed(model, evidence, plain, fit)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stringcast.stages.diagnose.reach.fitted", noted)
        return fit, reach(hypotheses, fit, library()["contact"]), asked


@pytest.mark.long
def test_a_plane_that_is_grazed_may_be_elsewhere_than_slopes_allow(grazed):
    """Turned about where it is touched: many of their standard deviations, and yet not anywhere. A graze says little of
    friction. Measured for six draws of noise: up to 0.04, 0.09 and 0.61 of their ranges."""
    fit, ends, _ = grazed
    truth = fit.theory.at({**TRUTH, **PLANE})
    for name, widest in {"contact.height": 0.1, "contact.tilt": 0.15, "contact.friction": 0.8}.items():
        low, high = ends[name]
        assert low < truth[fit.theory.model.names.index(name)] < high
        assert high - low < widest
    name = "contact.tilt"
    found = fit.chi[fit.theory.model.names.index(name)]
    assert max(abs(end - found) for end in ends[name]) > 20 * deviation(fit, name)


@pytest.mark.long
def test_of_what_is_at_least_so_hard_nothing_above_is_asked(grazed):
    """Nor simulated: a plane is as hard as any."""
    fit, _, asked = grazed
    place = fit.theory.model.names.index(HARD)
    assert len(asked) > 1
    assert all(start[place] < fit.chi[place] for start in asked)
