"""Effects of strings without weight, whose compiled step loop several tests share.

Without gravity the set-up compiles no loop. Memory is absent by its values.
"""

from stringcast.stages.model.effects.dahl_friction import DahlFriction
from stringcast.stages.model.effects.grasp_play import GraspPlay
from stringcast.stages.model.effects.gravity import Gravity
from stringcast.stages.model.effects.maxwell_slip import MaxwellSlip
from stringcast.stages.model.effects.standard_linear_solid import StandardLinearSolid
from stringcast.stages.model.string import PAPER_EFFECTS

MEMORY_EFFECTS = (MaxwellSlip, DahlFriction, StandardLinearSolid, GraspPlay)
WEIGHTLESS_WITH_MEMORY = (
    *(effect for effect in PAPER_EFFECTS if effect is not Gravity),
    *MEMORY_EFFECTS,
)
