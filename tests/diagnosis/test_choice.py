"""The choice of causes, with fits and trials left out of it."""

from types import SimpleNamespace

import numpy as np
import pytest

from stringcast.stages.diagnose import choose, diagnose, hypotheses


def from_costs(costs):
    """Hypotheses that were all fitted, with these costs of their causes' letters."""
    tried = {frozenset(names): SimpleNamespace(cost=cost) for names, cost in costs.items()}
    return SimpleNamespace(
        tried=tried,
        fit=lambda causes, others: None,
        level=lambda others, best: None,
        extended=lambda causes: {
            name: fit
            for key, fit in tried.items()
            if causes < key and len(key) == len(causes) + 1
            for name in key - causes
        },
    )


def test_two_causes_that_take_turns_do_not_keep_the_choice_going(monkeypatch):
    """Each is added beside the other, which is then no longer needed."""
    effects = {"a": SimpleNamespace(laws=dict), "b": SimpleNamespace(laws=dict)}
    hypotheses = SimpleNamespace(mismatch=lambda causes: 1.0, explained=lambda causes: False, library=effects)
    hypotheses.renewed = lambda causes: hypotheses
    asked = []

    def added(hypotheses, causes):
        asked.append(causes)
        assert len(asked) < 10
        return causes | ({"b"} if "a" in causes else {"a"})

    monkeypatch.setattr(choose, "_added", added)
    monkeypatch.setattr(choose, "_settled", lambda hypotheses, fewer, more: more)
    monkeypatch.setattr(choose, "_needed", lambda hypotheses, more, asks: more - asked[-1] if asked[-1] else more)
    monkeypatch.setattr(choose, "earns", lambda hypotheses, without, causes: True)
    monkeypatch.setattr(choose, "placed", lambda effect: False)
    _, best = choose.chosen(hypotheses, lambda share: None)
    assert len(best) == 1


@pytest.mark.parametrize(("explained", "named"), [(True, set()), (False, {"a"})])
def test_a_cause_whose_work_more_mass_points_do_is_not_named(monkeypatch, explained, named):
    """A slip of 0.1 mm/s was, of which the trials left out knew nothing once the string was fine. Where something is
    left without it, it stays until others are found beside it."""
    fine = SimpleNamespace(mismatch=lambda causes: -1.0, library={"a": object()}, evidence=None)
    fine.explained = lambda causes: explained
    fine.tried = dict.fromkeys((frozenset(), frozenset({"a"})), SimpleNamespace(residual=None))
    fine.fit = lambda causes, near: fine.tried[causes]
    few = SimpleNamespace(mismatch=lambda causes: 1.0, renewed=lambda causes: fine, fit=fine.fit)
    monkeypatch.setattr(choose, "_added", lambda hypotheses, causes: causes | {"a"})
    monkeypatch.setattr(choose, "_settled", lambda hypotheses, fewer, more: more)
    monkeypatch.setattr(choose, "earns", lambda hypotheses, without, causes: hypotheses is few)
    monkeypatch.setattr(choose, "placed", lambda effect: False)
    monkeypatch.setattr(choose, "visible", lambda evidence, residual: 0.0)
    assert choose.chosen(few, lambda share: None) == (fine, named)


@pytest.mark.parametrize(
    ("second", "found"),
    [
        (250.0, ({"b"}, {"b", "c"})),  # it explains 750 of what the best explains 900 of
        (400.0, ({"a"}, {"a", "d"})),  # 600 of them: not followed
    ],
)
def test_two_causes_are_sought_from_the_second_best_alone_as_well(second, found):
    """Of a tilt and a clock that drifts, wind explains most (bench 2016): but not with anything beside it."""
    costs = {"": 1000.0, "a": 100.0, "b": second, "ad": 60.0, "bc": 10.0}
    assert choose._two_added(from_costs(costs), frozenset()) == found


@pytest.mark.parametrize(
    ("cost", "parameters", "earned", "found"),
    [
        (5.0, 9, True, {"b", "c"}),
        (15.0, 9, True, {"a", "b"}),
        (5.0, 13, True, {"a", "b"}),  # further parameters must pay
        (5.0, 9, False, {"a", "b"}),
    ],
)
def test_what_came_first_is_asked_again_beside_what_came_later(monkeypatch, cost, parameters, earned, found):
    """An offset explains more than the lag that is there, until a slip is found beside it (bench 3044): nobody had
    asked of the slip alone."""
    both = SimpleNamespace(cost=10.0, theory=SimpleNamespace(names=("a", "b"), free=[0] * 9))
    other = SimpleNamespace(cost=cost, theory=SimpleNamespace(free=[0] * parameters))
    hypotheses = SimpleNamespace(tried={frozenset("ab"): both})
    hypotheses.fit = lambda causes, near: hypotheses.tried.setdefault(causes, SimpleNamespace(cost=500.0))

    def extended(context):
        assert context in hypotheses.tried
        hypotheses.tried[context | {"c"}] = other
        return {"a": both, "c": other}

    hypotheses.extended = extended
    monkeypatch.setattr(choose, "earns", lambda hypotheses, without, causes: earned)
    assert choose._settled(hypotheses, frozenset("a"), frozenset("ab")) == found


@pytest.mark.parametrize(
    ("costs", "steps"),
    [
        ({"g": 1000.0, "ga": 700.0, "gab": 10.0}, [("g", "ga"), ("ga", "gab"), ("g", "gb")]),  # bench 3101
        (
            {"g": 1000.0, "ga": 700.0, "gb": 750.0, "gab": 10.0, "gbc": 5.0},
            [("g", "ga"), ("gb", "gbc"), ("g", "gb"), ("g", "gc")],
        ),
    ],
)
def test_of_two_causes_each_that_was_not_is_asked_alone(costs, steps):
    """Beside a joint's gain, a tilt of gravity did some of a rest curvature's work, of which nobody had asked; with
    both, the tilt is nothing."""
    hypotheses = from_costs(costs)
    near, levelled = [], []
    hypotheses.fit = lambda causes, others: near.append((causes, others))
    hypotheses.level = lambda others, best: levelled.append((*others, best))
    found = list(choose._steps(hypotheses, frozenset("g")))
    assert found == [(set(before), set(after)) for before, after in steps]
    both = found[1][1]
    assert near == levelled == [(after, both) for _, after in found[2:]]


def test_what_explains_nearly_as_much_is_asked_at_last():
    """Of a strip that hangs aslant wind explained most, and nothing of trials left out; a tilt of gravity did both."""
    hypotheses = from_costs({"": 1000.0, "a": 100.0, "b": 120.0, "c": 150.0, "d": 400.0, "ax": 90.0})
    steps = [(set(before), set(after)) for before, after in choose._steps(hypotheses, frozenset())]
    assert steps == [(set(), {"a"}), ({"a"}, {"a", "x"}), (set(), {"x"}), (set(), {"b"}), (set(), {"c"})]


@pytest.mark.parametrize(("mismatch", "sought"), [(-0.65, True), (-1.05, False)])
def test_causes_are_sought_before_anybody_would_point_at_them(monkeypatch, mismatch, sought):
    """Dry friction in bending (bench 3770) is within 3.5 sigmas everywhere, and explains 315 of the log-likelihood; of
    benches without a cause -1.05 is the most."""
    monkeypatch.setattr(choose, "visible", lambda evidence, residual: 3.5)
    fit = SimpleNamespace(residual=None)
    hypotheses = SimpleNamespace(mismatch=lambda causes: mismatch, evidence=None, tried={frozenset(): fit})
    assert choose._suspect(hypotheses, frozenset()) == sought


def test_no_two_are_added_where_that_would_be_one_too_many():
    hypotheses = from_costs({"gh": 1000.0, "gha": 100.0, "ghb": 150.0, "ghab": 5.0})
    assert choose.MOST_CAUSES == 3
    steps = [after - {"g", "h"} for _, after in choose._steps(hypotheses, frozenset("gh"))]
    assert steps == [{"a"}, {"b"}]


def test_where_nothing_can_be_added_nothing_is():
    hypotheses = SimpleNamespace(tried={frozenset(): SimpleNamespace(cost=1.0)}, extended=lambda causes: {})
    assert set(choose._steps(hypotheses, frozenset())) == {(frozenset(), frozenset())}


@pytest.mark.parametrize(
    ("place", "acts", "left", "earned"),
    [
        (True, [9.0, 8.0, 0.0], [3.0, 3.0, 9.0], True),  # all that it reaches is explained
        (True, [9.0, 8.0, 0.0], [3.0, 5.0, 3.0], False),
        (False, [9.0, 8.0, 0.0], [3.0, 3.0, 3.0], False),  # what acts everywhere must be foretold
        (False, [9.0, 0.0, 0.0], [3.0, 9.0, 9.0], True),
        (False, [9.0, 0.0, 0.0], [5.0, 3.0, 3.0], False),
        (True, [9.0, 8.0], [3.0, 3.0], False),  # of two trials, in both of which it acts, nothing is left to check it
        (True, [9.0, 0.0], [3.0, 9.0], True),
        (True, [9.0, 8.0, 7.0], [3.0, 3.0, 3.0], True),
        (True, [9.0], [3.0], False),
    ],
)
def test_a_place_that_explains_all_trials_that_reach_it_need_not_foretell_them(monkeypatch, place, acts, left, earned):
    """Trials left out say no here: what one trial knows of a place, the others need not."""
    plain, fit = (
        SimpleNamespace(cost=cost, theory=SimpleNamespace(free=[0] * n), residual=None)
        for cost, n in ((1000.0, 8), (100.0, 9))
    )
    hypotheses = SimpleNamespace(
        tried={frozenset(): plain, frozenset({"a"}): fit},
        library={"a": object()},
        evidence=None,
        refitted=lambda fewer, more: None,
        by_chance=lambda causes: 0.0,
        foretells=lambda without, causes: -500.0,
    )
    monkeypatch.setattr(choose, "moved", lambda evidence, one, other: np.array(acts))
    monkeypatch.setattr(choose, "present", lambda evidence, fit, new: True)
    monkeypatch.setattr(choose, "noisiness", lambda evidence, fit: 1.0)
    monkeypatch.setattr(choose, "visible_in_each", lambda evidence, residual: np.array(left))
    monkeypatch.setattr(choose, "placed", lambda effect: place)
    assert choose.earns(hypotheses, frozenset(), frozenset({"a"})) == earned


@pytest.mark.parametrize(
    ("cost", "parameters", "earned", "kept"),
    [
        (90.0, 9, True, {"b", "c"}),
        (90.0, 9, False, {"a", "b"}),  # better where it was fitted, and no better foretold
        (97.0, 10, True, {"a", "b"}),  # a further parameter must pay
        (110.0, 9, True, {"a", "b"}),
    ],
)
def test_what_stands_against_the_chosen_takes_their_place_if_it_is_better_and_earns_it(
    monkeypatch, cost, parameters, earned, kept
):
    """It is asked of its new companions, too, whether they are still needed."""

    def fit(cost, parameters):
        return SimpleNamespace(cost=cost, theory=SimpleNamespace(free=[0] * parameters))

    chosen, other = frozenset("ab"), frozenset("bc")
    tried = {frozenset(): fit(500.0, 8), frozenset("b"): fit(300.0, 8), chosen: fit(100.0, 9)}
    tried |= {frozenset("c"): fit(1.0, 9), other: fit(150.0, parameters), frozenset("cd"): fit(400.0, 9)}
    asked = []

    def level(others, best):
        asked.append((list(others), best))
        if other in others:
            tried[other] = fit(cost, parameters)

    hypotheses = SimpleNamespace(tried=tried, level=level, fit=lambda causes, near: tried[causes])
    monkeypatch.setattr(choose, "earns", lambda hypotheses, without, causes: earned)
    needed = []
    monkeypatch.setattr(choose, "_needed", lambda hypotheses, causes, asks: needed.append(causes) or causes)
    assert choose.levelled(hypotheses, chosen) == kept
    assert asked[0] == ([other, frozenset("cd")], chosen)
    assert needed == ([other] if kept == other else [])


@pytest.mark.parametrize(("instead", "named"), [("tilt", {"tilt", "bending"}), ("plane", {"plane"})])
def test_beside_what_took_a_place_others_are_sought_too(monkeypatch, instead, named):
    """Of a strip a false plane was taken, and in the end a tilt in its place: nobody had asked of a bending beside."""

    def chosen(hypotheses, progress, begin=frozenset()):
        return hypotheses, begin | {"bending"} if begin else frozenset({"plane"})

    monkeypatch.setattr(diagnose, "_hypotheses", lambda ground, data: None)
    monkeypatch.setattr(diagnose, "astray", lambda ground: False)
    monkeypatch.setattr(diagnose, "chosen", chosen)
    monkeypatch.setattr(diagnose, "_cleaned", lambda data, *found: found)
    monkeypatch.setattr(diagnose, "levelled", lambda hypotheses, causes: frozenset({instead}))
    *_, causes = diagnose._sought(None, None, lambda ground: ground, None)
    assert causes == named


def test_planes_leave_room_for_other_effects(monkeypatch):
    """Of a dozen places of one plane the best two go on, not six."""
    plane, wind, lag = object(), object(), object()
    theories = {effect: SimpleNamespace(effect=effect, cost=cost) for effect, cost in ((wind, 50.0), (lag, 60.0))}
    probes = [SimpleNamespace(effect=e, theory=t, chi=0.0, gain=90.0) for e, t in theories.items()]
    probes.append(SimpleNamespace(effect=plane, theory=None, chi=0.0, gain=90.0))
    places = [SimpleNamespace(cost=float(k), chi=0.0, theory=SimpleNamespace(effect=plane, cost=k)) for k in range(12)]

    def fitted(evidence, theories, starts, most):
        return [SimpleNamespace(cost=theory.cost, chi=0.0, theory=theory) for theory in theories]

    monkeypatch.setattr(hypotheses, "placed", lambda effect: effect is plane)
    monkeypatch.setattr(hypotheses, "fitted", fitted)
    monkeypatch.setattr(hypotheses, "since", lambda evidence, fit, effect, seed: places)
    made = hypotheses.shortlisted(None, SimpleNamespace(cost=100.0), probes, 1.0, 0)
    assert [fit.theory.effect for fit in made] == [plane, plane, wind, lag]
