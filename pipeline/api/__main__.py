"""`python -m stringcast`: the command `stringcast`."""

from stringcast.pipeline.__main__ import cli

cli()
