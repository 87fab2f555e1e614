"""The study's results: tables, figures, and one page with the paper's numbers beside
ours.
"""

from __future__ import annotations

from pathlib import Path

from stringcast.data.schema import Table
from stringcast.data.store import write_table, write_text
from stringcast.pipeline.paper import scores, shown
from stringcast.pipeline.run.provenance import software_versions
from stringcast.pipeline.sweep.finish import common_settings
from stringcast.pipeline.sweep.ledger import Job, Ledger
from stringcast.stages.report.pages.paper import paper_figures, paper_page
from stringcast.stages.report.records import PaperRecord

TABLES: tuple[Table, ...] = (
    scores.RUNS,
    scores.CASTS,
    scores.RATES,
    scores.NEEDED,
    shown.PARAMETERS,
    *shown.TABLES,
)


def finish(folder: Path) -> list[Job]:
    """Write tables, figures and `report.html` from the ledger as it is now. Returns its
    jobs.
    """
    ledger = Ledger(folder)
    jobs = ledger.jobs()
    of_runs = scores.runs(ledger, jobs)
    of_casts, counted = scores.casts(ledger, of_runs), scores.pooled(of_runs)
    tables = {
        "runs": of_runs,
        "casts": of_casts,
        "rates": scores.rates(counted),
        "needed": scores.needed(counted),
    }
    tables |= {
        "parameters": shown.parameters(folder, of_runs),
        "numbers": scores.numbers(),
    }
    tables |= shown.shown(folder, shown.typical(of_runs), of_casts)
    made = software_versions()
    for table in TABLES:
        write_table(
            table,
            tables[table.name],
            folder / f"{table.name}.parquet",
            {"step": "paper"} | made,
        )
    write_table(
        scores.NUMBERS,
        tables["numbers"],
        folder / "numbers.parquet",
        {"step": "paper"} | made,
    )
    record = PaperRecord(
        tables, len(jobs), common_settings(jobs), {"seed": "of each run"} | made
    )
    drawn = paper_figures(record)
    for name, picture in drawn.items():
        picture.figure.savefig(folder / f"{name}.png", dpi=150, facecolor="white")
    write_text(folder / "report.html", paper_page(record, drawn))
    return jobs
