from ampm.control.controller import TrackingController as TrackingController
from ampm.exceptions import AmpmError as AmpmError
from ampm.exceptions import BodilyRefusal as BodilyRefusal
from ampm.exceptions import InputError as InputError
from ampm.exceptions import MathematicalRefusal as MathematicalRefusal
from ampm.exceptions import RefusedGait as RefusedGait
from ampm.exceptions import SolverError as SolverError
from ampm.parameters import GaitParameters as GaitParameters
from ampm.parameters import RunParameters as RunParameters
from ampm.planner.centroidal import CentroidalPlan as CentroidalPlan
from ampm.planner.centroidal import Law as Law
from ampm.planner.contacts import Contacts as Contacts
from ampm.planner.contacts import Footstep as Footstep
from ampm.planner.contacts import Phase as Phase
from ampm.planner.footsteps import plan_footsteps as plan_footsteps
from ampm.planner.periodic import plan as plan
from ampm.planners import FootstepPlanner as FootstepPlanner
from ampm.planners import PeriodicPlanner as PeriodicPlanner
from ampm.planners import TablePlanner as TablePlanner
from ampm.planners import make_plan as make_plan
from ampm.presets import preset_names as preset_names
from ampm.reference import Reference as Reference
from ampm.reference import Timing as Timing
from ampm.run_file import dump_run as dump_run
from ampm.run_file import load_run as load_run
from ampm.walk import Controller as Controller
from ampm.walk import ControlOutput as ControlOutput
from ampm.walk import Planner as Planner
from ampm.walk import Posture as Posture
from ampm.walk import Replanner as Replanner
from ampm.walk import State as State
from ampm.walk import Touch as Touch
from ampm.walk import WalkPlan as WalkPlan

__all__: list[str]
__version__: str
