"""The paper's figures again, one file for each kind, drawn from the study's tables alone."""

from __future__ import annotations

from matplotlib import style

from stringcast.stages.report.paper.figures.matching import matching
from stringcast.stages.report.paper.figures.parameters import parameters
from stringcast.stages.report.paper.figures.rates import rates
from stringcast.stages.report.paper.figures.shapes import shapes
from stringcast.stages.report.paper.figures.trajectories import trajectories
from stringcast.stages.report.paper.record import Drawn, PaperRecord
from stringcast.stages.report.picture import STYLE

ONE_MOTION = ("one_motion_A", "one_motion_B", "one_motion_C")
TARGETS = ("A_300_900", "A_400_700", "A_900_500")


def figures(record: PaperRecord) -> dict[str, Drawn]:
    """Every figure of which the study has data, by name."""
    with style.context(STYLE):
        drawn = {
            "hit_rates": rates(record),
            "fig_07": shapes(record, first_two(record, "A_500_900")),
            "fig_08": shapes(record, first_two(record, "C_300_900")),
            "fig_09": shapes(record, first_two(record, "B_400_700")),
            "fig_10": trajectories(record, TARGETS),
            "fig_11": shapes(record, [(name, record.casts(name)[-1]) for name in ONE_MOTION if record.casts(name)]),
            "table_4": parameters(record, ONE_MOTION),
            "fig_12": shapes(record, ends(record, "D_500_500")),
            "fig_13": shapes(record, ends(record, "wall")),
            "fig_14": matching(record, "wall"),
        }
    return {name: figure for name, figure in drawn.items() if figure is not None}


def first_two(record: PaperRecord, condition: str) -> list[tuple[str, int]]:
    """The first and second cast of an experiment, as far as there are any."""
    return [(condition, number) for number in record.casts(condition)[:2]]


def ends(record: PaperRecord, condition: str) -> list[tuple[str, int]]:
    """The first and the last cast of an experiment."""
    made = record.casts(condition)
    return [(condition, number) for number in dict.fromkeys(made[:1] + made[-1:])]
