"""Picture of the studies: change of each metric from level to level, on logarithmic axes."""

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from validation.show.style import into_file
from validation.study.convergence.levels import Study
from validation.study.convergence.study import Convergence, MetricStudy

_LEAST = 1e-9  # relative change below which it is rounding
_LEFT_OUT = ("com_agreement_maximum", "angular_momentum_agreement_maximum", "standing_weight_error")
"""Rounding, on whatever level."""
_STYLES = {
    "o-": "asymptotic range: distance to the\nextrapolated value",
    "o--": "no asymptotic range: change to the\nnext finer level",
    "s-": "model parameter: a sensitivity,\nno convergence",
}


@into_file
def draw(result: Convergence) -> Figure:
    """Draw all studies, and in the last cell the legend."""
    drawn = [
        item
        for item in result.metrics.values()
        if item.tolerance is not None and not item.quantity.is_exact and item.name not in _LEFT_OUT
    ]
    rows = -(-(len(result.studies) + 1) // 2)
    # Figures are made without pyplot: no global state, no display, safe in any thread.
    figure = Figure(figsize=(12.4, 4.1 * rows + 0.5), dpi=110, layout="constrained")
    steps = result.request.run.gait.steps
    figure.suptitle(f"{result.request.title}: what the numbers depend on, {steps} steps a level")
    grid = list(figure.subplots(rows, 2, squeeze=False).flat)
    for axes, study in zip(grid, result.studies, strict=False):
        _draw_study(axes, study, drawn)
    legend = grid[len(result.studies)]
    for style, label in _STYLES.items():
        legend.plot([], [], style, color="0.3", mfc="none" if style == "o--" else "0.3", label=label)
    for number, item in enumerate(drawn):
        legend.plot([], [], color=_colour(number), label=item.name)
    legend.legend(loc="center", ncols=2, labelspacing=0.8)
    for axes in grid[len(result.studies) :]:
        axes.set_axis_off()
    return figure


def _draw_study(axes: Axes, study: Study, items: Sequence[MetricStudy]) -> None:
    """One study; relative to the gait's own values."""
    factor, unit = study.display
    at = factor * np.array(study.values)
    top = _LEAST
    for number, item in enumerate(items):
        values, style, fill, x = np.array(item.levels[study.name]), "s-", _colour(number), at
        if study.numerical:
            limit = item.estimates[study.name].extrapolated
            if limit is not None:
                values, style = np.abs(values - limit), "o-"
            else:
                values, style, fill, x = np.abs(np.diff(values)), "o--", "none", at[:-1]
        values = values / abs(item.value) if item.value else np.full(values.shape, np.nan)
        if study.numerical:
            values = np.where(values > _LEAST, values, np.nan)  # drawn as a gap
            top = max(top, float(np.nanmax(values, initial=_LEAST)))
        axes.plot(x, values, style, color=_colour(number), lw=1.2, ms=4.5, mfc=fill)
    axes.set_xscale("log")
    if not study.numerical:
        axes.axvline(factor * study.values[study.own], color="0.6", lw=0.8, ls=":")
    elif top == _LEAST:  # no positive value for the logarithmic axis
        axes.set_ylim(0.0, 1.0)
        axes.text(0.5, 0.5, "no change but rounding", transform=axes.transAxes, ha="center", va="center")
    else:
        axes.set_yscale("log")
        for order in (1, 2):
            guide = 2.5 * top * (at / at[0]) ** order
            axes.plot(at, guide, color="0.6", lw=0.8, ls=":")
            axes.annotate(f"order {order}", (at[-1], guide[-1]), fontsize="x-small", color="0.4")
    axes.set_title(study.name)
    axes.set_xlabel(f"{study.title} [{unit or '1'}]")
    axes.set_ylabel(f"{'error' if study.numerical else 'value'}, over the gait's own value [1]")
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticks(at, [f"{value:.3g}" for value in at])


def _colour(number: int) -> str:
    return mpl.colors.to_hex(mpl.colormaps["tab20"](number % 20))
