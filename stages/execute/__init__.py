"""Execute: perform a motion with an arm and film it, or make a dry run."""

from stringcast.data.artifacts import Motion, Trial
from stringcast.stages.spec import SameIteration, StageSpec

STAGE = StageSpec(
    name="execute",
    makes=Trial,
    folder="trial",
    uses=("arm", "camera", "hardware", "execute", "seed"),
    run="stages.execute.execute.run",
    inputs={"motion": SameIteration(Motion)},
    by=(
        "stages.execute.execute.execute",
        "stages.execute.dry_run.dry_run",
        "stages.execute.dry_run.slow_run",
    ),
    moves_arm=True,
)
