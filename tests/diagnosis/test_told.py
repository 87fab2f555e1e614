"""What is of a simulation and not of the string is called resolution, and beside other causes is only used."""

from types import SimpleNamespace

import pytest

from stringcast.stages.diagnose.verdict import Judgement, _groups, _probability, _silent, _told

A, B, POINTS = "tip_mass", "wind", "equal_points"
COURT = SimpleNamespace(library={n: SimpleNamespace(of_string=n != POINTS) for n in (A, B, POINTS)})


def told(causes, chances, groups):
    probability = _probability(chances, _silent(COURT, causes, groups), 0.01)
    names = tuple(sorted(causes.union(*groups)))
    return _told(COURT, Judgement("ambiguous" if groups else "effect", names, probability, groups, chances, 0.0))


@pytest.mark.parametrize(
    ("causes", "others", "groups", "named", "sure"),
    [
        ({POINTS}, [], (), {"resolution"}, {"resolution": 0.98}),
        ({POINTS, B}, [], (), {B}, {B: 0.98}),
        ({A}, [{POINTS}], ((A, POINTS),), {A, "resolution"}, {A: 0.49, "resolution": 0.49}),
        ({B, POINTS}, [{B, A}], ((POINTS, A),), {A, B, "resolution"}, {B: 0.49, A: 0.245, "resolution": 0.245}),
        ({B, A}, [{B, POINTS}], ((A, POINTS),), {A, B, "resolution"}, {B: 0.49, A: 0.245, "resolution": 0.245}),
    ],
)
def test_everything_named_has_its_probability(causes, others, groups, named, sure):
    sets = [frozenset(each) for each in (causes, *others)]
    said = told(frozenset(causes), dict.fromkeys(sets, 1 / len(sets)), groups)
    assert set(said.causes) == named
    assert set(said.causes) <= set(said.probability)
    assert sum(said.probability.values()) == pytest.approx(1.0)
    for name, share in sure.items():
        assert said.probability[name] == pytest.approx(share, abs=0.005)


@pytest.mark.parametrize(
    ("chances", "groups"),
    [
        ({"ab": 0.7, "ac": 0.3}, [("b", "c")]),
        ({"ab": 0.7, "ac": 0.01, "cd": 0.02}, []),
        ({"ab": 0.4, "cd": 0.6}, [("a", "b", "c", "d")]),  # only both together could be others
        ({"ab": 0.5, "bd": 0.2, "ac": 0.3}, [("a", "d"), ("b", "c")]),
    ],
)
def test_what_could_stand_in_place_of_causes_is_in_a_group_with_them(chances, groups):
    assert list(_groups({frozenset(key): chance for key, chance in chances.items()}, frozenset("ab"))) == groups
