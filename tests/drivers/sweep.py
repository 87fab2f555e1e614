"""`python -m tests.drivers.sweep [EVERY]`: every fault at every EVERY-th frame of a movement, by the real driver over
a real terminal. What became of each goes to data/results/serial_faults/faults.parquet."""

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import pandas as pd

sys.path.insert(0, str(Path(__file__).parent))
from rig import ARM, WATCHDOG, driver, emulator, events, movement, standstill

from stringcast.data.schema import Column, Table
from stringcast.data.store import write_table
from stringcast.hardware.serial.emulator.device import KINDS
from stringcast.pipeline.provenance import code
from stringcast.stages.execute.interfaces import HardwareError

RESULT = Path(__file__).resolve().parents[2] / "data/results/serial_faults/faults.parquet"
FAULTS = Table(
    "faults",
    "a fault at one frame of a movement, and what became of the arm",
    (
        Column("kind", "", "what went wrong", "text"),
        Column("frame", "1", "number of the velocity command at which it did", "int"),
        Column("outcome", "", "why the movement ended early; empty if it did not", "text"),
        Column("lost", "1", "ticks without an acknowledgement; -1 where the movement ended early", "int"),
        Column("stood", "", "the firmware's log ends with the arm at rest", "bool"),
        Column("standstill", "s", "from the fault to standstill for good, device clock"),
        Column("rest", "s", "from the first stop, trip, latch or restart after the fault to standstill"),
    ),
)
SLOW = replace(ARM, speed=(5.0,) * 3)  # just what the movement needs: what an encoder can truly report is little
STOPS = ("idle", "tripped", "latched", "fresh")


def tried(kind: str, frame: int, log: Path) -> dict[str, object]:
    """One movement with one fault."""
    outcome, lost = "", -1
    with emulator(log, "--fault", f"{kind}:{frame}") as port:
        try:
            with driver(port, SLOW) as arm:
                performance = arm.perform(movement(0.2))
            lost = int(performance.ticks["t_acknowledged"].isna().sum())
        except HardwareError as error:
            outcome = str(error).partition(": ")[2].partition(" at ")[0]
        took = standstill(log, kind)
    row = {"kind": kind, "frame": frame, "outcome": outcome, "lost": lost, "stood": took is not None}
    return row | {"standstill": took, "rest": rested(events(log), kind)}


def rested(noted: list[dict], kind: str) -> float | None:
    """Seconds from the command to stop to the last standstill."""
    begun = next((e["t"] for e in noted if e["event"] == kind), None)
    stops = [e["t"] for e in noted if begun is not None and e["t"] >= begun and e["event"] in STOPS]
    stands = [e["t"] for e in noted if e["event"] == "stands"]
    return max(stands[-1] - stops[0], 0.0) if stops and stands else None


def main() -> None:
    """All of them, with a line for each kind."""
    parser = argparse.ArgumentParser("python -m tests.drivers.sweep", description=__doc__)
    parser.add_argument("every", type=int, nargs="?", default=1, help="frames from one that is struck to the next")
    every = parser.parse_args().every
    rows, begun = [], time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        for kind in KINDS:
            rows += [
                tried(kind, n, Path(folder) / f"{kind}-{n}.jsonl") for n in range(1, len(movement(0.2)) - 1, every)
            ]
            of = pd.DataFrame([row for row in rows if row["kind"] == kind])
            print(
                f"{kind:17} {len(of):3} tried, {of['stood'].sum():3} stood, at most {of['standstill'].max():.3f} s, "
                f"{(of['outcome'] != '').sum()} ended early",
                flush=True,
            )
    RESULT.parent.mkdir(parents=True, exist_ok=True)
    origin = {"command": " ".join(["python -m tests.drivers.sweep", *sys.argv[1:]]), "code": code()}
    origin |= {"watchdog": WATCHDOG, "arm": repr(SLOW)}
    write_table(FAULTS, pd.DataFrame(rows), RESULT, origin)
    print(f"{len(rows)} movements in {time.monotonic() - begun:.0f} s; {RESULT}")


if __name__ == "__main__":
    main()
