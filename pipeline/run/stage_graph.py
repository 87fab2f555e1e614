"""The graph of a run: the source of each input of a stage.

A stage states the kinds of its inputs. The source is the last stage before it, in the
order of the mode, that makes an artifact of this kind. The setting `inputs` of a stage
can name another one, as in `estimate.inputs.points=extract`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import UnionType
from typing import Any, NamedTuple

from stringcast.data.errors import suggest_known_name
from stringcast.pipeline.settings.composition import Settings, UserError
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.stages.spec import CollectedTrials, LatestIteration, StageSpec

INPUTS_SETTING = "inputs"  # of a stage's block of settings
Kind = type | UnionType


class Port(NamedTuple):
    """An input of a stage, or a part of its trials.

    name, kind: of the artifact. is_earlier: the artifact comes from an earlier
    iteration, and may be absent.
    """

    name: str
    kind: Kind
    is_earlier: bool = False


@dataclass(frozen=True)
class Connection:
    """The source of one input.

    Parameters
    ----------
    stage, port : str
        Stage and name of its input.
    source : str
        Stage that makes the artifact; empty for a given artifact.
    artifact : str
        Name of the artifact in an iteration.
    is_earlier : bool
        The artifact comes from an earlier iteration.
    """

    stage: str
    port: str
    source: str
    artifact: str
    is_earlier: bool

    def describe(self) -> str:
        """Describe the input and its source."""
        source = f"of {self.source}" if self.source else "of the stored trial"
        earlier = " in an earlier iteration" if self.is_earlier else ""
        return f"{self.port} {source}{earlier}"


@dataclass(frozen=True)
class StageGraph:
    """Stages of an iteration in their order, and the connections between them."""

    stages: tuple[str, ...] = ()
    connections: tuple[Connection, ...] = ()

    def artifact_name(self, stage: str, port: str) -> str:
        """Return the artifact name of an input, or else the input's name."""
        for connection in self.connections:
            if (connection.stage, connection.port) == (stage, port):
                return connection.artifact
        return port

    def part_names(self, stage: str, trials: CollectedTrials) -> list[str]:
        """Return the artifact names of the parts of a stage's trials."""
        return [self.artifact_name(stage, part) for part in trials.parts]

    def describe_sources(self) -> dict[str, str]:
        """Describe the sources of all inputs of each stage."""
        taken: dict[str, list[str]] = {stage: [] for stage in self.stages}
        for connection in self.connections:
            taken.setdefault(connection.stage, []).append(connection.describe())
        return {
            stage: f"takes {', '.join(sources) or 'nothing'}"
            for stage, sources in taken.items()
        }

    def precedes_movement(self, stage: str) -> bool:
        """Return whether the arm moves in or after this stage."""
        if stage not in self.stages:
            return False
        following = self.stages[self.stages.index(stage) :]
        return any(stages()[name].moves_arm for name in following)

    @property
    def movement(self) -> str | None:
        """Artifact name of the first stage that moves an arm."""
        for name in self.stages:
            if stages()[name].moves_arm:
                return stages()[name].folder
        return None


def build_graph(
    names: Sequence[str],
    config: Settings,
    given: Mapping[str, Kind],
    outcome: StageSpec | None = None,
) -> StageGraph:
    """Connect the stages of a mode, in the order of an iteration.

    `given` are the kinds of artifacts given to an iteration, by name. `outcome` is the
    mode's own use of artifacts, as a stage. Raises UserError for an unknown stage, and
    for an input that is missing, ambiguous, of another kind or from a later stage; for
    an artifact that nothing uses.
    """
    refuse_unknown_stages(names)
    specs = [stages()[name] for name in names]
    consumers = specs if outcome is None else [*specs, outcome]
    connections = []
    for position, stage in enumerate(consumers):
        chosen = chosen_sources(stage, config)
        automatic: dict[tuple[str, bool], str] = {}
        for port in ports_of(stage):
            if port.name in chosen:
                source = find_chosen(stage, port, chosen[port.name], names, position)
            else:
                usable = specs if port.is_earlier else specs[:position]
                source = last_maker(port.kind, usable)
                key = (source, port.is_earlier)
                if source and key in automatic:
                    refuse_ambiguous(stage, automatic[key], port)
                automatic[key] = port.name
            artifact = stages()[source].folder if source else given_name(port, given)
            if artifact:
                connections.append(
                    Connection(stage.name, port.name, source, artifact, port.is_earlier)
                )
            elif not port.is_earlier:
                refuse_missing(stage, port, names)
    refuse_unused(specs, connections)
    return StageGraph(tuple(names), tuple(connections))


def ports_of(stage: StageSpec) -> Iterator[Port]:
    """Yield the inputs of a stage; each part of collected trials is one input."""
    for name, wanted in stage.inputs.items():
        if isinstance(wanted, CollectedTrials):
            for part, kind in wanted.parts.items():
                yield Port(part, kind)
        else:
            yield Port(name, wanted.kind, isinstance(wanted, LatestIteration))


def chosen_sources(stage: StageSpec, config: Settings) -> dict[str, str]:
    """Return the setting `inputs` of a stage; raise UserError for unknown inputs."""
    setting = f"{stage.name}.{INPUTS_SETTING}"
    block = config.get(stage.name) or {}
    if not isinstance(block, Mapping):
        raise UserError(
            f"{stage.name} = {block!r}",
            f"it must hold the settings of stage {stage.name}",
            f"Choose {stage.name}=...",
        )
    chosen = block.get(INPUTS_SETTING) or {}
    if not isinstance(chosen, Mapping):
        raise UserError(
            f"{setting} = {chosen!r}",
            "it must hold names of inputs, each with the name of a stage",
            "Change it.",
        )
    known = [port.name for port in ports_of(stage)]
    for name in chosen:
        if name not in known:
            raise UserError(
                f"{setting}.{name}",
                f"stage {stage.name} has no such input",
                suggest_known_name(name, known),
            )
    return dict(chosen)


def find_chosen(
    stage: StageSpec, port: Port, source: Any, names: Sequence[str], position: int
) -> str:
    """Return the stage chosen for an input; refuse an impossible source."""
    setting = f"{stage.name}.{INPUTS_SETTING}.{port.name} = {source}"
    if source not in names:
        raise UserError(
            setting,
            "this run has no such stage",
            suggest_known_name(str(source), names),
        )
    makes = stages()[source].makes
    if not issubclass(makes, port.kind):
        raise UserError(
            setting,
            f"{source} makes {makes.__name__}, but {stage.name} takes "
            f"{kind_name(port.kind)}",
            "Choose another stage.",
        )
    if not port.is_earlier and names.index(source) >= position:
        raise UserError(
            setting,
            f"{source} does not come before {stage.name}, so that each would "
            "wait for the other",
            "Change the order of the stages in mode.",
        )
    return str(source)


def last_maker(kind: Kind, specs: Sequence[StageSpec]) -> str:
    """Return the last stage that makes this kind; empty without one."""
    for spec in reversed(specs):
        if issubclass(spec.makes, kind):
            return spec.name
    return ""


def given_name(port: Port, given: Mapping[str, Kind]) -> str:
    """Return the given artifact for an input; empty without one."""
    for name, kind in given.items():
        if isinstance(kind, type) and issubclass(kind, port.kind):
            return name
    return ""


def refuse_unknown_stages(names: Sequence[str]) -> None:
    """Raise UserError for an unknown or repeated stage."""
    for position, name in enumerate(names):
        if name not in stages():
            raise UserError(
                "mode",
                f"there is no stage {name!r}",
                suggest_known_name(name, [*stages()]),
            )
        if name in names[:position]:
            raise UserError("mode", f"stage {name} stands twice", "Remove one.")


def refuse_ambiguous(stage: StageSpec, first: str, port: Port) -> None:
    """Raise UserError for two inputs with the same artifact."""
    raise UserError(
        f"stage {stage.name}",
        f"its inputs {first} and {port.name} are both {kind_name(port.kind)}",
        f"Name the stage of each: +{stage.name}.{INPUTS_SETTING}.{port.name}=...",
    )


def refuse_missing(stage: StageSpec, port: Port, names: Sequence[str]) -> None:
    """Raise UserError for an input without a source."""
    makers = []
    for name, spec in stages().items():
        if issubclass(spec.makes, port.kind) and name != stage.name:
            makers.append(name)
    remedy = "Leave the stage out."
    if makers:
        remedy = f"Put one that makes it before: {' or '.join(makers)}."
    raise UserError(
        "",
        f"stage {stage.name} takes {port.name} ({kind_name(port.kind)}), which "
        f"no stage before it makes; the stages are {', '.join(names)}",
        remedy,
    )


def refuse_unused(
    specs: Sequence[StageSpec], connections: Sequence[Connection]
) -> None:
    """Raise UserError for a stage whose artifact is not used."""
    used = {connection.source for connection in connections}
    for spec in specs:
        if spec.name not in used and not spec.is_end:
            raise UserError(
                "mode",
                f"nothing uses what stage {spec.name} makes ({spec.makes.__name__})",
                f"Leave the stage out, name it in the setting `{INPUTS_SETTING}` "
                "of another stage, or mark it as an end (is_end in its "
                "description).",
            )


def kind_name(kind: Kind) -> str:
    """Return the name of a kind, or the names of several."""
    kinds = kind.__args__ if isinstance(kind, UnionType) else (kind,)
    return " or ".join(part.__name__ for part in kinds)
