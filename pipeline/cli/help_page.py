"""Page of `python -m pipeline --help`: example calls, commands and every setting.

Hydra's own help takes a second, as it reads the options of all groups.
"""

from __future__ import annotations

from collections.abc import Sequence

import yaml

from stringcast.pipeline.cli.command_line_hints import group_options
from stringcast.pipeline.cli.terminal import with_program_name
from stringcast.pipeline.commands import command_list
from stringcast.pipeline.settings.composition import compose_settings, conf_folders
from stringcast.pipeline.settings.setting_comments import annotate_settings
from stringcast.stages.model.library import effect_files

HELP_TEMPLATE = """\
Cast an unknown string at a target with a robot arm; learn the string from each cast.

  # string A to (400, 700) mm, by the motion most likely to hit
  python -m pipeline
  # any setting, by its name
  python -m pipeline target.x=0.45 target.y=0.65
  # one experiment of the paper, by the paper's method
  python -m pipeline +experiment=stringB
  # a sweep over settings
  python -m pipeline --multirun method=paper estimate.beta=0.99,0.995 seed=0,1,2
  # a sweep in parallel, by joblib, ray or slurm
  python -m pipeline +experiment=sweep hydra/launcher=joblib
  # continue a sweep, or show its state
  python -m pipeline +experiment=sweep hydra.sweep.dir=...
  # estimate again from stored trials
  python -m pipeline +experiment=estimate trials=outputs/...
  # find what the simulation gets wrong, and why
  python -m pipeline +experiment=diagnose trials=outputs/...
  # diagnose, and perform the motion that distinguishes candidate causes
  python -m pipeline +experiment=decide trials=outputs/...
  # measure the camera with pictures of a board
  python -m pipeline +experiment=calibrate source=images \\
    source.folder=tilted plane.folder=flat
  # use the measured camera
  python -m pipeline +experiment=stringB camera_from=outputs/...
  # measure camera and clock against the arm
  python -m pipeline +experiment=align
  # use the model that a diagnosis or an alignment made
  python -m pipeline model_from=outputs/...

Commands (python -m pipeline <command> --help says more):
{commands}

Groups and their options (group=option, +experiment=option):
{groups}

Effects (effects=[name,name]; parameters, units and ranges in conf/README.md):
{effects}

Settings of this call:
{settings}
"""


def help_text(overrides: Sequence[str]) -> str:
    """Return the help with the settings composed from overrides."""
    settings = compose_settings(overrides)
    text = yaml.safe_dump(settings, sort_keys=False, allow_unicode=True)
    return with_program_name(HELP_TEMPLATE).format(
        commands=command_list(),
        groups="\n".join(group_lines()),
        effects=", ".join(effect_files()),
        settings="\n".join(annotate_settings(text)),
    )


def group_lines() -> list[str]:
    """Return a line with the options of each group, except Hydra's own."""
    names = set()
    for conf in conf_folders():
        for path in conf.rglob("*/"):
            names.add(path.relative_to(conf).as_posix())
    lines = []
    for name in sorted(names):
        options = group_options(name)
        if options and not name.startswith("hydra"):
            lines.append(f"{name}: {', '.join(options)}")
    return lines
