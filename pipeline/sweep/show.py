"""A sweep on the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path

from rich.text import Text

from stringcast.pipeline.sweep.ledger import DONE, FAILED, Job

COLOUR = {DONE: "green", FAILED: "red"}


def line(job: Job, left: str) -> Text:
    """A line about a job that ended, and about those left."""
    said = Text.assemble((f"{job.state:<8}", COLOUR.get(job.state, "yellow")), f"{job.seconds:7.1f} s  ")
    said.append(f"{' '.join(job.overrides)}  {left}")
    return said.append(f"\n         {first(job.error)}", "red") if job.error else said


def left(seconds: float, waiting: int, of: int) -> str:
    """The number of jobs that still wait, and the time that they take at the pace so far. seconds: since the first."""
    ahead = timedelta(seconds=round(seconds / max(of - waiting, 1) * waiting))
    return f"({waiting} left, about {ahead})" if waiting else ""


def summary(jobs: Sequence[Job], folder: Path, elsewhere: int) -> str:
    """Numbers of jobs by how they ended, and what to do about the others. elsewhere: how many another process is at."""
    count = Counter(job.state for job in jobs)
    left = len(jobs) - count[DONE] - count[FAILED] - elsewhere
    said = [f"{count[DONE]} of {len(jobs)} job(s) of the sweep are done."]
    again = f"the same command with hydra.sweep.dir={folder}"
    if elsewhere:
        said.append(f"{elsewhere} are run by another process, which completes the table when it ends; or {again} does.")
    if left:
        said.append(f"{left} did not end: give {again} to go on.")
    if count[FAILED]:
        said.append(f"{count[FAILED]} job(s) of the sweep failed: give {again} hydra.launcher.retry=true to try again.")
    return "\n".join([*said, str(folder / "report.html")])


def first(text: str) -> str:
    """The first line of a text."""
    return text.splitlines()[0] if text else ""
