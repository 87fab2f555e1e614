"""Make the notebook of the plain script: `python -m tests.api.make_notebook`."""

import json
from pathlib import Path

FOLDER = Path(__file__).parent
SCRIPT, NOTEBOOK = FOLDER / "notebook.py", FOLDER / "stringcast.ipynb"


def notebook_text():
    """Return the notebook as JSON, with a cell for each `# %%` of the script."""
    cells = []
    for number, part in enumerate(SCRIPT.read_text("utf-8").split("# %%")[1:]):
        heading, _, body = part.partition("\n")
        lines = body.strip("\n").split("\n")
        cell = {"id": f"cell-{number}", "metadata": {}}
        if "[markdown]" in heading:
            lines = [line.removeprefix("#").removeprefix(" ") for line in lines]
            cell |= {"cell_type": "markdown"}
        else:
            cell |= {"cell_type": "code", "execution_count": None, "outputs": []}
        cells.append(cell | {"source": "\n".join(lines).splitlines(keepends=True)})
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook = {
        "cells": cells,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(notebook, indent=1, ensure_ascii=False, sort_keys=True) + "\n"


if __name__ == "__main__":
    NOTEBOOK.write_text(notebook_text(), encoding="utf-8")
