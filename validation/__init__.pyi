from validation.judge.compare import Comparison as Comparison
from validation.judge.compare import Statistics as Statistics
from validation.judge.metrics import Metric as Metric
from validation.judge.metrics import register as register
from validation.judge.metrics import unregister as unregister
from validation.judge.uncertainty import load_uncertainty as load_uncertainty
from validation.progress import Progress as Progress
from validation.run.fit import Fit as Fit
from validation.run.fit import fit_log as fit_log
from validation.run.judge_log import judge_log as judge_log
from validation.run.judge_log import judge_run as judge_run
from validation.run.replay import replay as replay
from validation.run.trial import Trial as Trial
from validation.run.walk import walk as walk
from validation.show.report import write_report as report
from validation.show.viewer import show_recording as view
from validation.store.saved import load_saved_run as load
from validation.study.explain import explain as explain
from validation.study.many import Execution as Execution
from validation.study.many import Task as Task
from validation.study.many import walk_many as walk_many
from validation.study.rank import rank as rank
from validation.study.robustness.study import robustness as robustness
from validation.study.sweep.design import SweepDefinition as SweepDefinition
from validation.study.sweep.run import sweep as sweep
from validation.trial.disturbances import Disturbance as Disturbance
from validation.trial.disturbances import Plant as Plant
from validation.trial.disturbances import Push as Push

# A type checker takes these three as public only if they are listed, as their names are new here.
__all__ = ["load", "report", "view"]
