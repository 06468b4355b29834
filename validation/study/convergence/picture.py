"""Picture of the numerical studies: change of each judged metric from level to level."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from validation.judge.uncertainty import rounding
from validation.show.style import save_figure, style
from validation.study.convergence.result import Convergence


@style()
def draw(result: Convergence, path: Path) -> None:
    """Draw a plot for every numerical study, side by side, and the legend below.

    Changes that are rounding are gaps, and dots are a change in proportion to the level.
    """
    found = [study for study in result.studies if study.numerical]
    judged = [item for item in result.metrics.values() if item.tolerance is not None and item.value]
    figure = Figure(figsize=(12.4, 6.0), dpi=110, layout="constrained")
    steps = result.request.run.gait.steps
    figure.suptitle(f"{result.request.title}: change to the next finer level, {steps} steps a level")
    plots = figure.subplots(1, len(found), squeeze=False)[0]
    for axes, study in zip(plots, found, strict=True):
        at = np.array(study.values)
        axes.set_prop_cycle(color=mpl.colormaps["tab20"].colors)  # type: ignore[attr-defined]
        largest = 0.0
        for item in judged:
            changes = np.abs(np.diff(result.studied[item.name].levels[study.name]))
            changes[~(changes > rounding(item.value, item.of.unit))] = np.nan
            changes /= abs(item.value)
            largest = float(np.nanmax(changes, initial=largest))
            axes.loglog(at[:-1], changes, "o-", lw=1.2, ms=4.5, label=item.label)
        axes.loglog(at, 2.5 * (largest or np.nan) * at / at[0], ":", color="0.6", label="order 1")
        axes.set_title("" if largest else "no change but rounding", fontsize=9)
        axes.set_xlabel(study.key)
        axes.set_xticks(at, [f"{value:g}" for value in at])
        axes.minorticks_off()
    plots[0].set_ylabel("change, over the gait's own value [1]")
    figure.legend(*plots[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    save_figure(figure, path)
