"""The evidence as tables."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from stringcast.data.artifacts import CAUSES, LIKENESS, RESIDUALS, SCREENING, THEORIES
from stringcast.stages.diagnose.beginning import simulated
from stringcast.stages.diagnose.compare import moved
from stringcast.stages.diagnose.hypotheses import Causes, Hypotheses
from stringcast.stages.diagnose.noise import parts, systematic
from stringcast.stages.diagnose.reach import reach
from stringcast.stages.diagnose.screen import Probe
from stringcast.stages.diagnose.single_effects.tables import tangents
from stringcast.stages.diagnose.verdict import Judgement
from stringcast.stages.model.effect import Effect, ModelChange, placed

ALIKE = 8  # effects whose likeness is shown: the most promising


def joined_names(causes: Causes) -> str:
    """As it stands in tables."""
    return " + ".join(sorted(causes))


def residuals(hypotheses: Hypotheses, causes: Causes) -> pd.DataFrame:
    """Table RESIDUALS."""
    base, extended = hypotheses.tried[frozenset()], hypotheses.tried[causes]
    frames = []
    both = (parts(hypotheses.evidence, simulated(hypotheses.evidence, fit)) for fit in (base, extended))
    floors = parts(hypotheses.evidence, hypotheses.floor.sigma)
    for case, plain, more, own in zip(hypotheses.evidence.cases, *both, floors, strict=True):
        first, then = (case.points + case.sigma[:, None] * off for off in (plain, more))
        along = tangents(case.frame, case.s, first)
        off = case.points - first
        table = {"trial": case.name, "t": case.times[case.frame], "s": case.s}
        table |= dict(zip(("x", "y"), case.points.T, strict=True)) | {"sigma": own[:, 0], "doubt": case.sigma}
        table |= dict(zip(("base_x", "base_y", "extended_x", "extended_y"), (*first.T, *then.T), strict=True))
        table["base_tangential"] = np.sum(off * along, axis=1)
        table["base_normal"] = off[:, 1] * along[:, 0] - off[:, 0] * along[:, 1]
        frames.append(pd.DataFrame(table))
    return RESIDUALS.check(pd.concat(frames, ignore_index=True))


def theories(hypotheses: Hypotheses, judgement: Judgement) -> pd.DataFrame:
    """Table THEORIES, those that fit best first."""
    base = hypotheses.tried[frozenset()]
    before = max(systematic(hypotheses.evidence, base.residual), 1e-12)
    rows = [
        {
            "causes": joined_names(key),
            "parameters": len(fit.theory.free),
            "mean_square": fit.mean_square,
            "fit_gain": base.cost - fit.cost,
            "held_out_gain": _held_gain(hypotheses, key),
            "by_chance": hypotheses.chance_gains.get(key, float("nan")),
            "moved": moved(hypotheses.evidence, base, fit).max() if key else 0.0,
            "unexplained": systematic(hypotheses.evidence, fit.residual) / before,
            "probability": judgement.chances.get(key, 0.0),
        }
        for key, fit in hypotheses.tried.items()
    ]
    return THEORIES.check(pd.DataFrame(rows).sort_values("fit_gain", ascending=False, ignore_index=True))


def _held_gain(hypotheses: Hypotheses, key: Causes) -> float:
    if key not in hypotheses.predictions or frozenset() not in hypotheses.predictions:
        return float("nan")
    return float((hypotheses.predictions[frozenset()].costs - hypotheses.predictions[key].costs).sum())


def screening(hypotheses: Hypotheses) -> pd.DataFrame:
    """Table SCREENING."""
    rows = [
        {"context": joined_names(context), "effect": name, "predicted_gain": some[0].gain}
        for context, probes in hypotheses.probes.items()
        for name, some in probes.items()
    ]
    return SCREENING.check(pd.DataFrame(rows)) if rows else SCREENING.empty()


def likeness(hypotheses: Hypotheses) -> pd.DataFrame:
    """Table LIKENESS: of the most promising effects of the first screening."""
    probes: dict[str, list[Probe]] = next(iter(hypotheses.probes.values()), {})
    best = sorted((some[0] for some in probes.values()), key=lambda probe: -probe.gain)[:ALIKE]
    rows = [
        {"effect": a.effect.name, "other": b.effect.name, "cosine": abs(float(a.direction @ b.direction))}
        for i, a in enumerate(best)
        for b in best[:i]
    ]
    return LIKENESS.check(pd.DataFrame(rows)) if rows else LIKENESS.empty()


def causes(
    hypotheses: Hypotheses, chosen: Causes, judgement: Judgement, library: Mapping[str, type[Effect]]
) -> pd.DataFrame:
    """Table CAUSES: those named, each with its parameters as fitted among the chosen or in place of its look-alike."""
    rows = []
    for name in judgement.causes:
        effect = library[name]
        common = {"effect": name, "probability": judgement.probability.get(name, 0.0)}
        if issubclass(effect, ModelChange):
            nothing = dict.fromkeys(("value", "low", "high"), np.nan) | dict.fromkeys(("meaning", "unit"), "")
            rows.append(common | {"sentence": effect.words({}), "parameter": "", "at_least": False, **nothing})
            continue
        key = _with(chosen, judgement, name)
        fit = hypotheses.sharp(key).fit
        common["sentence"] = effect.words(fit.theory.of(effect, fit.chi))
        rows += [common | row for row in _parameters(hypotheses, key, effect)]
    return CAUSES.check(pd.DataFrame(rows)) if rows else CAUSES.empty()


def _with(chosen: Causes, judgement: Judgement, name: str) -> Causes:
    """The likeliest set with this cause, of those as large as the chosen."""
    if name in chosen:
        return chosen
    return max((key for key in judgement.chances if name in key), key=lambda key: judgement.chances[key])


def _parameters(hypotheses: Hypotheses, causes: Causes, effect: type[Effect]) -> list[dict[str, object]]:
    fit, between = hypotheses.sharp(causes).fit, _between(hypotheses, causes, effect)
    rows = []
    for parameter in effect.parameters:
        place = fit.theory.model.names.index(effect.qualified(parameter))
        ends = parameter.value(np.array(between[effect.qualified(parameter)]))
        if parameter.at_least:
            ends[1] = parameter.high
        row = {"parameter": effect.qualified(parameter), "meaning": parameter.meaning, "unit": parameter.unit}
        found = {"value": float(parameter.value(fit.chi[place])), "low": ends[0], "high": ends[1]}
        rows.append(row | found | {"at_least": parameter.at_least})
    return rows


def _between(hypotheses: Hypotheses, causes: Causes, effect: type[Effect]) -> dict[str, tuple[float, float]]:
    """Exponents between which each parameter of an effect is, by qualified name."""
    sharp = hypotheses.sharp(causes)
    low, high = sharp.interval(hypotheses.evidence)
    ends = {sharp.fit.theory.model.names[p]: (low[k], high[k]) for k, p in enumerate(sharp.fit.theory.free)}
    if not placed(effect):
        return ends
    far = reach(hypotheses, hypotheses.tried[causes], effect)
    return {name: (min(ends[name][0], near), max(ends[name][1], off)) for name, (near, off) in far.items()}
