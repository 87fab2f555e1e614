"""The choice of causes, with fits and trials left out of it."""

from types import SimpleNamespace

from stages.diagnose import choose


def test_two_causes_that_take_turns_do_not_keep_the_choice_going(monkeypatch):
    """Each is added beside the other, which is then no longer needed."""
    effects = {"a": SimpleNamespace(laws=dict), "b": SimpleNamespace(laws=dict)}
    hypotheses = SimpleNamespace(mismatch=lambda causes: 1.0, library=effects)
    hypotheses.renewed = lambda causes: hypotheses
    asked = []

    def added(hypotheses, causes):
        asked.append(causes)
        assert len(asked) < 10
        return causes | ({"b"} if "a" in causes else {"a"})

    monkeypatch.setattr(choose, "_added", added)
    monkeypatch.setattr(choose, "_settled", lambda hypotheses, fewer, more: more)
    monkeypatch.setattr(choose, "_needed", lambda hypotheses, more: more - asked[-1] if asked[-1] else more)
    monkeypatch.setattr(choose, "earns", lambda hypotheses, without, causes: True)
    monkeypatch.setattr(choose, "placed", lambda effect: False)
    _, best = choose.chosen(hypotheses, lambda share: None)
    assert len(best) == 1
