"""Write tables and figures of the study, and a page that compares with the paper."""

from __future__ import annotations

from pathlib import Path

from stringcast.data.schema import Table
from stringcast.data.store import write_table, write_text
from stringcast.pipeline.paper import figure_data, scores
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
    scores.NUMBERS,
    figure_data.PARAMETERS,
    *figure_data.CAST_TABLES,
)


def finish(folder: Path) -> list[Job]:
    """Write tables, figures and `report.html` from the ledger, and return its jobs."""
    ledger = Ledger(folder)
    jobs = ledger.jobs()
    runs = scores.run_table(ledger, jobs)
    casts = scores.cast_table(ledger, runs)
    runs_with_pool = scores.add_pooled_experiment(runs)
    typical_runs = figure_data.choose_typical_runs(runs)
    tables = {
        "runs": runs,
        "casts": casts,
        "rates": scores.rate_table(runs_with_pool),
        "needed": scores.needed_cast_table(runs_with_pool),
        "numbers": scores.read_printed_numbers(),
        "parameters": figure_data.parameter_table(folder, runs),
    }
    tables |= figure_data.cast_tables(folder, typical_runs, casts)

    versions = software_versions()
    origin = {"step": "paper"} | versions
    for table in TABLES:
        path = folder / f"{table.name}.parquet"
        write_table(table, tables[table.name], path, origin)

    provenance = {"seed": "of each run"} | versions
    record = PaperRecord(tables, len(jobs), common_settings(jobs), provenance)
    figures = paper_figures(record)
    for name, picture in figures.items():
        picture.figure.savefig(folder / f"{name}.png", dpi=150, facecolor="white")
    write_text(folder / "report.html", paper_page(record, figures))
    return jobs
