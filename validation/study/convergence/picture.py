"""Picture of the numerical studies: change of each judged metric from level to level."""

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from validation.show.style import into_file
from validation.study.compare.metrics import rounding
from validation.study.convergence.levels import Study
from validation.study.convergence.result import Convergence


@into_file
def draw(result: Convergence) -> Figure:
    """Draw a plot for every numerical study, side by side, and the legend below."""
    found = [study for study in result.studies if study.numerical]
    # Figures are made without pyplot: no global state, no display, safe in any thread.
    figure = Figure(figsize=(12.4, 6.0), dpi=110, layout="constrained")
    steps = result.request.run.gait.steps
    figure.suptitle(f"{result.request.title}: change to the next finer level, {steps} steps a level")
    if not found:
        return figure
    plots = list(figure.subplots(1, len(found), squeeze=False).flat)
    for axes, study in zip(plots, found, strict=True):
        _draw_study(axes, study, result)
    plots[0].set_ylabel("change, over the gait's own value [1]")
    figure.legend(*plots[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _draw_study(axes: Axes, study: Study, result: Convergence) -> None:
    """One study; changes that are rounding are gaps, and dots are a change in proportion to the level."""
    judged = [item for item in result.metrics.values() if item.tolerance is not None and item.value]
    at = np.array(study.values)
    largest = 0.0
    axes.set_prop_cycle(color=mpl.colormaps["tab20"].colors)  # type: ignore[attr-defined]
    for item in judged:
        changes = np.abs(np.diff(result.studied[item.name].levels[study.name]))
        changes[~(changes > rounding(item.value, item.of.unit))] = np.nan
        changes /= abs(item.value)
        largest = float(np.nanmax(changes, initial=largest))
        axes.loglog(at[:-1], changes, "o-", lw=1.2, ms=4.5, label=item.label)
    if largest:
        axes.loglog(at, 2.5 * largest * at / at[0], ":", color="0.6", label="order 1")
    else:
        axes.text(0.5, 0.5, "no change but rounding", transform=axes.transAxes, ha="center")
    axes.set_title(study.title)
    axes.set_xticks(at, study.shown)
    axes.minorticks_off()
