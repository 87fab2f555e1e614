"""Wiring of stages: errors, effects of settings, and stale results."""

from dataclasses import dataclass, replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stringcast.data.artifacts import Film, Points
from stringcast.pipeline.commands import load_command
from stringcast.pipeline.modes import Cast
from stringcast.pipeline.modes.stepwise import Stepwise
from stringcast.pipeline.run.iterations import History
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.run.stage_graph import build_graph
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.stages import spec
from stringcast.stages.spec import SameIteration, StageSpec
from tests.faults.toy import number, rows, toy_experiment, toy_run

CAST = ("generate", "execute", "extract", "estimate")
SMOOTH = StageSpec(
    name="smooth",
    makes=Points,
    folder="smoothed",
    uses=("smooth",),
    run="stages.spec.toy_smooth",
    inputs={"points": SameIteration(Points)},
)


def run_smooth(call, points):
    """Move all points by the setting."""
    moved = points.points.assign(
        x=points.points["x"] + call.setup.config["smooth"]["by"]
    )
    return Points(moved, points.readings, points.masks)


@pytest.fixture
def smooth(monkeypatch):
    """Register a stage between extraction and estimation."""
    monkeypatch.setitem(stages(), "smooth", SMOOTH)
    monkeypatch.setattr(spec, "toy_smooth", run_smooth, raising=False)


def smoothed_experiment(by=1.0, order=(*CAST[:3], "smooth", CAST[3]), **inputs):
    here = toy_experiment(mode=Cast(stages=order), smooth={"by": by})
    estimate = {**here.config["estimate"], "inputs": inputs}
    return replace(here, config={**here.config, "estimate": estimate})


def connections(graph):
    """Return stage and description of each connection."""
    return {
        f"{connection.stage}: {connection.describe()}"
        for connection in graph.connections
    }


def test_inputs_come_from_the_last_stage_of_their_kind(smooth):
    graph = build_graph((*CAST[:3], "smooth", "estimate"), {}, {})
    assert connections(graph) == {
        "generate: motion of generate in an earlier iteration",
        "generate: estimate of estimate in an earlier iteration",
        "execute: motion of generate",
        "extract: trial of execute",
        "smooth: points of extract",
        "estimate: trial of execute",
        "estimate: points of smooth",
        "estimate: estimate of estimate in an earlier iteration",
    }


def test_setting_inputs_chooses_another_stage(smooth):
    config = {"estimate": {"inputs": {"points": "extract"}}}
    order = (*CAST[:3], "smooth", "estimate", "predict")
    graph = build_graph(order, config, {})
    assert "estimate: points of extract" in connections(graph)
    assert "predict: points of smooth" in connections(graph)


def test_stored_artifacts_fill_inputs_without_a_stage(smooth):
    given = {"trial": Film, "points": Points}
    graph = build_graph(("extract", "estimate"), {}, given)
    assert "extract: trial of the stored trial" in connections(graph)
    assert "estimate: points of extract" in connections(graph)
    graph = build_graph(("smooth", "estimate"), {}, given)
    assert "smooth: points of the stored trial" in connections(graph)
    assert graph.artifact_name("smooth", "points") == "points"


BOTH = replace(SMOOTH, inputs={"a": SameIteration(Points), "b": SameIteration(Points)})


@pytest.mark.parametrize(
    ("names", "config", "message"),
    [
        (("generat",), {}, "no stage 'generat'. Did you mean 'generate'"),
        (("generate", "generate"), {}, "generate stands twice. Remove one"),
        (
            ("generate", "execute", "estimate"),
            {},
            r"estimate takes points \(Points\), .*stages are generate, execute, "
            r"estimate\. Put one that makes it before: extract or smooth",
        ),
        (("execute", "generate"), {}, r"execute takes motion \(Motion\)"),
        (
            ("generate", "execute", "extract", "estimate", "smooth"),
            {},
            r"nothing uses what stage smooth makes \(Points\)",
        ),
        (CAST, {"estimate": {"inputs": {"point": "extract"}}}, "mean 'points'"),
        (CAST, {"estimate": {"inputs": {"points": "extrac"}}}, "mean 'extract'"),
        (CAST, {"estimate": {"inputs": "extract"}}, "must hold names of inputs"),
        (
            CAST,
            {"estimate": {"inputs": {"points": "execute"}}},
            "execute makes Trial, but estimate takes Points",
        ),
        (
            (*CAST[:3], "smooth", "estimate"),
            {"smooth": {"inputs": {"points": "smooth"}}},
            "smooth does not come before smooth",
        ),
    ],
)
def test_wrong_wiring_is_refused(smooth, names, config, message):
    with pytest.raises(UserError, match=message):
        build_graph(names, config, {})


def test_inputs_of_equal_kind_must_be_named(smooth, monkeypatch):
    monkeypatch.setitem(stages(), "both", replace(BOTH, name="both", is_end=True))
    order = (*CAST[:3], "smooth", "both", "estimate")
    with pytest.raises(UserError, match=r"a and b are both Points.*\+both\.inputs\.b="):
        build_graph(order, {}, {})
    config = {"both": {"inputs": {"b": "extract"}}}
    assert "both: a of smooth" in connections(build_graph(order, config, {}))


def test_inserted_stage_takes_effect(smooth, tmp_path):
    plain, _ = toy_run(tmp_path / "plain", toy_experiment())
    made, _ = toy_run(tmp_path / "run", smoothed_experiment())
    assert made == plain  # the smoothing is not counted
    fits = [
        (tmp_path / name / "iterations/01/estimate/fit.parquet").read_bytes()
        for name in ("plain", "run")
    ]
    assert fits[0] != fits[1]
    assert toy_run(tmp_path / "run", smoothed_experiment())[0] == []


@pytest.mark.parametrize(
    ("change", "stale"),
    [
        ({"by": 2.0}, {"01/smoothed", "01/estimate", "02/motion", "02/trial"}),
        ({"points": "extract"}, {"01/estimate", "02/motion", "02/trial"}),
    ],
)
def test_changed_setting_or_wiring_makes_later_steps_stale(
    smooth, tmp_path, capsys, change, stale
):
    run = tmp_path / "run"
    toy_run(run, smoothed_experiment())
    (run / "config.json").unlink()
    _, output = toy_run(run, smoothed_experiment(**change))
    made = {
        line.split()[1].strip(":").removeprefix("iterations/")
        for line in output.splitlines()
        if line.startswith("recomputing")
    }
    assert stale <= made
    assert not made & {"01/motion", "01/trial", "01/points"}


def test_graph_is_printed(capsys):
    assert load_command("graph")(["+experiment=stringB"]) == 0
    printed = capsys.readouterr().out
    assert "estimate: takes trial of execute, points of extract" in printed
    assert "hit test: takes motion of generate, points of extract" in printed


# --- random graphs and changes


@dataclass(frozen=True)
class Chain(Stepwise):
    """A mode that runs all stages of a graph once."""

    order: tuple[str, ...]

    def check(self, experiment):
        """Accept everything."""

    def graph(self, config):
        return build_graph(self.order, config, {})

    def run_steps(self, experiment, folder, executor):
        history = History(executor, graph=self.graph(experiment.config))
        history.begin_iteration()
        for name in self.order:
            history.make_artifact(name)
        return RunResult(folder, tuple(history.iterations), "")


def run_node(call, **inputs):
    """Compute a number from a setting and all inputs."""
    name = call.by()
    MADE.append(name)
    value = number(
        call.setup.config[name], *(artifact.points for artifact in inputs.values())
    )
    tables = {table: rows(schema) for table, schema in Points.TABLES.items()}
    tables["points"] = tables["points"].assign(x=value)
    return Points(**tables)


MADE = []


@st.composite
def random_graphs(draw):
    """Draw the sources (earlier nodes) of each node, and the node that changes."""
    count = draw(st.integers(2, 7))
    sources = []
    for node in range(count):
        earlier = st.sets(st.integers(0, node - 1), max_size=3) if node else st.just(())
        sources.append(sorted(draw(earlier)))
    return sources, draw(st.integers(0, count - 1))


@settings(
    max_examples=10,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(random_graphs())
def test_only_steps_after_a_change_are_repeated(
    monkeypatch, tmp_path_factory, graph_and_change
):
    sources, changed = graph_and_change
    folder = tmp_path_factory.mktemp("graph")
    monkeypatch.setattr(spec, "toy_node", run_node, raising=False)
    names = [f"node{i}" for i in range(len(sources))]
    values = {}
    for name, before in zip(names, sources, strict=True):
        node = StageSpec(
            name=name,
            makes=Points,
            folder=name,
            uses=(name,),
            run="stages.spec.toy_node",
            inputs={f"from{i}": SameIteration(Points) for i in before},
            is_end=True,
        )
        monkeypatch.setitem(stages(), name, node)
        values[name] = {"value": 0, "inputs": {f"from{i}": names[i] for i in before}}

    def make_again(values):
        here = toy_experiment(mode=Chain(tuple(names)), **values)
        calls = {name: lambda name=name: name for name in names}
        here = replace(here, stages={**here.stages, **calls})
        MADE.clear()
        (folder / "config.json").unlink(missing_ok=True)
        toy_run(folder, here)
        return list(MADE)

    assert make_again(values) == names
    assert make_again(values) == []
    values[names[changed]] = {**values[names[changed]], "value": 1}
    downstream = {changed}
    for node, before in enumerate(sources):
        if downstream & {*before}:
            downstream.add(node)
    assert make_again(values) == [names[node] for node in sorted(downstream)]
