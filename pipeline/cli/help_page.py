"""`python -m pipeline --help`: what can be asked, and every setting.

Hydra's own help takes a second to list the options of all groups, for it reads them.
"""

from __future__ import annotations

from collections.abc import Sequence

import yaml

from stringcast.pipeline.cli.terminal import with_program_name
from stringcast.pipeline.commands import command_list
from stringcast.pipeline.settings.composition import CONF_FOLDER, compose_settings
from stringcast.pipeline.settings.setting_comments import annotate_settings
from stringcast.stages.model.library import effect_files

HELP_TEMPLATE = """\
Cast an unknown string at a target with a robot arm, and learn the string from each cast.

  python -m pipeline                                  string A at (400, 700) mm, by the motion most likely to hit
  python -m pipeline target.x=0.45 target.y=0.65      any setting, by its name
  python -m pipeline +experiment=stringB              one experiment of the paper, by the paper's method
  python -m pipeline --multirun method=paper estimate.beta=0.99,0.995 seed=0,1,2
  python -m pipeline +experiment=sweep hydra/launcher=joblib   side by side; or ray, slurm
  python -m pipeline +experiment=sweep hydra.sweep.dir=...     go on with a sweep, or see how it stands
  python -m pipeline +experiment=estimate trials=outputs/...   estimate again from stored trials
  python -m pipeline +experiment=diagnose trials=outputs/...   what does the simulation get wrong, and why?
  python -m pipeline +experiment=decide trials=outputs/...     and perform the motion that decides between look-alikes
  python -m pipeline +experiment=calibrate source=images source.folder=tilted plane.folder=flat   measure the camera
  python -m pipeline +experiment=stringB camera_from=outputs/...   with the camera that was measured
  python -m pipeline +experiment=align                         measure camera and clock against the arm
  python -m pipeline model_from=outputs/...                      with the model that a diagnosis or an alignment made

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
    """The help, with the settings as these overrides make them."""
    groups = []  # each group of settings but Hydra's own, with its options
    for folder in sorted(
        path
        for path in CONF_FOLDER.rglob("*")
        if path.is_dir() and path != CONF_FOLDER / "hydra"
    ):
        options = sorted(file.stem for file in folder.glob("*.yaml"))
        if options and CONF_FOLDER / "hydra" not in folder.parents:
            groups.append(
                f"{folder.relative_to(CONF_FOLDER).as_posix()}: {', '.join(options)}"
            )
    settings = "\n".join(
        annotate_settings(
            yaml.safe_dump(
                compose_settings(overrides), sort_keys=False, allow_unicode=True
            )
        )
    )
    return with_program_name(HELP_TEMPLATE).format(
        commands=command_list(),
        groups="\n".join(groups),
        effects=", ".join(effect_files()),
        settings=settings,
    )
