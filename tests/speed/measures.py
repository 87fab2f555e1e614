"""What is measured, a function a part of the table. Goals are those of the project."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from functools import partial
from importlib import import_module

import numba
import numpy as np
import pandas as pd
import yaml

from stringcast.data.artifacts import MASKS, READINGS, Observation
from stringcast.stages.estimate import random_search
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.engine import batching, kernel_codegen
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.engine.stability import steps_per_tick
from stringcast.stages.model.model import Model
from tests.speed import fused, limits, scalar
from tests.speed.engine import point_steps, step_loop
from tests.speed.stopwatch import in_turns
from tests.speed.trial import PIXEL, ROOT, TIMES, hand, string_b

SIZES = (10, 25, 60)  # mass points
BATCHES = (1, 16, 64, 256, 2000)  # candidates
ROUNDS = 9
NS = 1e9


@dataclass(frozen=True)
class Row:
    """One line of the table: a value with the range seen, and the goal it is held to,
    if any.
    """

    measure: str
    subject: str
    value: float
    unit: str
    low: float = np.nan
    high: float = np.nan
    points: float = np.nan
    threads: float = np.nan
    batch: float = np.nan
    at_least: float = np.nan
    at_most: float = np.nan


def seen(
    measure: str, subject: str, series: pd.Series, unit: str, **more: float
) -> Row:
    """A row of the median and the range of what the rounds gave."""
    return Row(
        measure, subject, series.median(), unit, series.min(), series.max(), **more
    )


def machine(limit: limits.Limits) -> list[Row]:
    """This machine's limits on one core."""
    return [
        Row(
            "machine", "vector peak, float64", 1e-9 / limit.small, "GFLOP/s", threads=1
        ),
        Row("machine", "a division", limit.division * NS, "ns", threads=1),
        Row("machine", "a square root", limit.root * NS, "ns", threads=1),
    ]


def loops(limit: limits.Limits) -> list[Row]:
    """The step loop alone on one core, over n, beside hand-written loops of Eq. 1, and
    its share of the limit.
    """
    string, values = string_b(10)
    calls, work = _hand_written(), {}
    for points in SIZES:
        loop = _step_loop(points, 64)
        calls[f"engine {points}"], work[f"engine {points}"] = loop, loop.point_steps
    work |= {"scalar": work["engine 10"] / 64, "hand-fused": work["engine 10"]}
    each = in_turns(calls, ROUNDS) / pd.Series(work) * NS
    least = (
        limit.of(
            limits.work(
                kernel_codegen.generate_source(
                    string.effects, string.names, string.integrator
                )
            )
        )
        * NS
    )
    per, own = "ns per mass-point-step and core", {"threads": 1, "batch": 64}
    rows = [
        seen(
            per,
            "engine, step loop",
            each[f"engine {points}"],
            "ns",
            points=points,
            **own,
        )
        for points in SIZES
    ]
    rows += [
        seen(per, "hand-fused loop", each["hand-fused"], "ns", points=10, **own),
        seen(per, "scalar loop", each["scalar"], "ns", points=10, threads=1, batch=1),
        Row(per, "limit of this machine", least, "ns", threads=1),
    ]
    for points in SIZES:
        share = least / each[f"engine {points}"]
        rows.append(
            seen(
                "share of the machine's limit",
                "engine, step loop",
                share,
                "1",
                points=points,
                **own,
            )
        )
    times, cost = (
        each["scalar"] / each["engine 10"],
        each["engine 10"] / each["hand-fused"],
    )
    return [
        *rows,
        seen(
            "speed over the scalar loop",
            "engine, step loop",
            times,
            "1",
            points=10,
            **own,
            at_least=5,
        ),
        seen(
            "time over the hand-fused loop",
            "engine, step loop",
            cost,
            "1",
            points=10,
            **own,
            at_most=1.1,
        ),
    ]


def _step_loop(points: int, batch: int):  # type: ignore[no-untyped-def]
    string, values = string_b(points)
    return step_loop(string, hand(), np.tile(values, (batch, 1)), TIMES)


def _hand_written():  # type: ignore[no-untyped-def]
    """Calls of the hand-written loops on string B, n = 10: the scalar one for one
    candidate, the fused one for 64.
    """
    string, values = string_b(10)
    steps, _ = steps_per_tick(string, string.material(values[None]), hand().tick)
    path = scalar.path(hand(), int(steps[0]))
    start = simulate(string, hand(), values[None], TIMES[:2]).points[0, 0]
    blocks = 64 // fused.W
    parameters = np.tile(np.repeat(values, fused.W), (blocks, 1))
    at_rest = fused.state(start, blocks)
    rows, out = (
        batching.aligned_zeros(at_rest.shape),
        np.empty((blocks, path.shape[0], 2, 10, fused.W)),
    )

    def many() -> None:
        rows[:] = at_rest
        fused.cast(rows, parameters, 10, string.segment_length, path, hand().tick, out)

    return {
        "scalar": partial(
            scalar.cast, start, values, string.segment_length, path, hand().tick
        ),
        "hand-fused": many,
    }


def batches() -> list[Row]:
    """`simulate` as a whole on one core, over the number of candidates."""
    string, values = string_b(10)
    some = {count: np.tile(values, (count, 1)) for count in BATCHES}
    calls = {
        str(count): partial(simulate, string, hand(), some[count], TIMES)
        for count in BATCHES
    }
    each = in_turns(calls, 5)
    rows = []
    for count in BATCHES:
        where = {"points": 10, "threads": 1, "batch": count}
        cost = each[str(count)] / point_steps(string, hand(), some[count], TIMES) * NS
        rows.append(
            seen(
                "ns per mass-point-step and core",
                "engine, simulate",
                cost,
                "ns",
                **where,
            )
        )
        rows.append(
            seen(
                "candidates per second",
                "engine, simulate",
                count / each[str(count)],
                "1/s",
                **where,
            )
        )
    return rows


def threads() -> list[Row]:
    """Two threads against one, by the wall clock, where other work on the machine
    shows; and in a thread's own time.

    The latter is all the time of one thread over what the first of two spends: how
    evenly the work is shared and what stays serial. It is the most that two free cores
    could give, for what they cost each other shows only when both run.
    """
    loop = _step_loop(10, 512)
    string, values = string_b(10)
    whole = partial(simulate, string, hand(), np.tile(values, (512, 1)), TIMES)
    names = {"engine, step loop": loop, "engine, simulate": whole}
    calls = {
        (name, count): partial(on_threads, count, call)
        for name, call in names.items()
        for count in (1, 2)
    }
    wall, own = in_turns(calls, ROUNDS, time.perf_counter), in_turns(calls, ROUNDS)
    measure, more = (
        "speed on two threads over one",
        {"points": 10, "threads": 2, "batch": 512},
    )
    return [
        *(
            seen(
                measure, name, wall[name, 1] / wall[name, 2], "1", **more, at_least=1.9
            )
            for name in names
        ),
        *(
            seen(measure, f"{name}, own time", own[name, 1] / own[name, 2], "1", **more)
            for name in names
        ),
    ]


def on_threads(count: int, call) -> None:  # type: ignore[no-untyped-def]
    """Call with so many threads at most."""
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    try:
        call()
    finally:
        numba.set_num_threads(1)


def equals() -> list[Row]:
    """Engine, MuJoCo and PyElastica on the same cord at equal accuracy: within a pixel,
    and within 1 mm.
    """
    return [row for most in (PIXEL, 1e-3) for row in _equal(most)]


def _equal(most: float) -> list[Row]:
    """Their speeds with a tip error of at most `most` [m], by how many cords are
    simulated at once.
    """
    # whose contenders the ordinary set-up does without
    contest = import_module("tests.speed.contest")
    entered = contest.entries(most)
    each = in_turns(
        {
            (e.contender.name, n): partial(e.run, n)
            for e in entered
            for n in e.contender.counts
        },
        5,
    )
    within = f", within {most * 1e3:g} mm"
    rows = []
    for e in entered:
        parts, step = e.resolution
        name = f"{e.contender.name}, step {step * 1e3:g} ms"
        rows += [
            Row("tip error" + within, name, e.error * 1e3, "mm", points=parts),
            Row("its limit from the engine's", name, e.apart * 1e3, "mm"),
        ]
        for count in e.contender.counts:
            speed = count * TIMES[-1] / each[e.contender.name, count]
            where = {"points": parts, "threads": 1, "batch": count}
            rows.append(
                seen("cord-seconds per second" + within, name, speed, "1", **where)
            )
    for count in entered[0].contender.counts:
        ratio = each["MuJoCo", count] / each["engine", count]
        rows.append(
            seen(
                "speed over MuJoCo, per core" + within,
                "engine",
                ratio,
                "1",
                threads=1,
                batch=count,
            )
        )
    eight, many = entered[2].contender.counts[0], entered[0].contender.counts[-1]
    ratio = each["PyElastica", eight] / eight / each["engine", many] * many
    rows.append(
        seen(
            "speed over PyElastica, per core" + within,
            "engine",
            ratio,
            "1",
            threads=1,
            batch=many,
        )
    )
    return rows


def estimation() -> list[Row]:
    """The paper's estimation, as in conf/: 2,000 candidates on a trial of 1.5 s.

    On two threads by the wall clock, and what it costs one thread without other work's
    share.
    """
    string, values = string_b(10)
    motion = simulate(string, hand(), values[None], TIMES).points[0]
    columns = {
        "t": np.repeat(TIMES, 10),
        "s": np.tile(string.arc_lengths(), len(TIMES)),
    }
    points = pd.DataFrame(
        columns | dict(zip("xy", motion.reshape(-1, 2).T, strict=True))
    )
    pose = dict(zip(("x", "y", "theta"), hand().pose[0].T, strict=True))
    trial = Observation(
        "t01",
        points,
        READINGS.empty(),
        MASKS.empty(),
        grasp=pd.DataFrame({"t": TIMES, **pose}),
    )
    settings = _conf("estimate/random_search.yaml")
    settings["matching"] = Matching(**settings["matching"])
    arm, camera = (
        Arm(**_conf("arm/paper.yaml")),
        Camera(**_conf("camera/highspeed.yaml")),
    )
    call = partial(
        random_search.estimate,
        Model(string, arm, camera),
        [trial],
        None,
        seed=1,
        manipulation=1,
        **settings,
    )
    wall = in_turns({"wall": partial(on_threads, 2, call)}, 3, time.perf_counter)[
        "wall"
    ]
    alone = in_turns({"processor": call}, 3)["processor"]
    more = {"points": 10, "batch": settings["candidates"]}
    return [
        seen(
            "one estimation",
            "random search, wall clock",
            wall,
            "s",
            threads=2,
            **more,
            at_most=2,
        ),
        seen(
            "one estimation",
            "random search, processor time",
            alone,
            "s",
            threads=1,
            **more,
        ),
    ]


def _conf(path: str) -> dict:  # type: ignore[type-arg]
    block = yaml.safe_load((ROOT / "conf" / path).read_text())
    return {
        k: tuple(v) if isinstance(v, list) else v
        for k, v in block.items()
        if k != "_target_"
    }


COMPILE = """
import time
from tests.speed.trial import *
string, values = string_b(10)
begun = time.process_time()
simulate(string, hand(), values[None], TIMES[:2])
print(time.process_time() - begun)
"""


def compilation() -> list[Row]:
    """The first call of `simulate` in a new process, with an empty cache and with a
    filled one, in processor time.
    """
    with tempfile.TemporaryDirectory() as cache:
        first = [_first_call(cache) for _ in range(4)]
    warm = pd.Series(first[1:])
    return [
        Row("first call, compiling", "engine, empty cache", first[0], "s", at_most=10),
        seen("first call, compiling", "engine, filled cache", warm, "s", at_most=1),
    ]


def _first_call(cache: str) -> float:
    environment = os.environ | {"STRINGCAST_CACHE": cache}
    command = [sys.executable, "-c", COMPILE]
    done = subprocess.run(
        command, cwd=ROOT, env=environment, check=True, capture_output=True, text=True
    )
    return float(done.stdout)


def measured() -> list[Row]:
    """Of the engine, one-threaded but where a row says otherwise."""
    numba.set_num_threads(1)
    limit = limits.measured()
    return [
        *machine(limit),
        *loops(limit),
        *batches(),
        *threads(),
        *equals(),
        *estimation(),
        *compilation(),
    ]


def framed(rows: list[Row]) -> pd.DataFrame:
    """Rows as a table, those of a measure together."""
    # in the order in which each first appears
    together = {row.measure: None for row in rows}
    return pd.DataFrame(
        [asdict(row) for measure in together for row in rows if row.measure == measure]
    )
