"""A sweep in one sentence: how many runs ended how, and whether that is a pass."""

from __future__ import annotations

from dataclasses import dataclass

from validation.study.sweep.table import BROKEN, STATES, State, SweepTable


@dataclass(frozen=True)
class SweepVerdict:
    """Verdict on a sweep as a whole.

    Attributes:
        css: ``pass``, ``fail`` or ``open``.
        headline: a few words.
        sentence: with the counts.
    """

    css: str
    headline: str
    sentence: str


def judge_sweep(sweep: SweepTable) -> SweepVerdict:
    """Say whether a sweep passes: every run that walked met every tolerance, and every run has an answer."""
    counts = sweep.counts
    walked = sum(counts[state] for state in STATES if state.walked)
    passed, missing = counts[State.PASS], sweep.planned - len(sweep)
    if walked == 0:
        css, headline, sentence = "open", "nothing walked", f"None of {_runs(len(sweep))} walked"
    elif passed == walked:
        css, headline = "pass", "pass"
        sentence = f"{_runs(walked).capitalize()} that walked: all within every tolerance"
    else:
        css, headline = "fail", f"{share(passed, walked)} of what walked passes"
        sentence = f"{_runs(walked)} that walked: {passed:,} within every tolerance"
    if missing or any(counts[state] for state in BROKEN):
        css = "open" if css == "pass" else css
        headline = "unfinished" if missing else headline if css == "fail" else "not every run has an answer"
    parts = [f"{counts[state]:,} {state.label}" for state in STATES[1:] if counts[state]]
    sentence += f"; {', '.join(parts)}." if parts else "."
    if missing:
        sentence += f" {missing:,} of {_runs(sweep.planned)} are missing: 'ampm sweep --resume' walks them."
    return SweepVerdict(css, headline, sentence)


def share(part: int, whole: int) -> str:
    """A percentage that never rounds to all or nothing."""
    if whole == 0 or part in (0, whole):
        return "100\u00a0%" if part and part == whole else "0\u00a0%"
    percent = 100.0 * part / whole
    text = f"{percent:.0f}" if 1.0 <= percent < 99.5 else f"{percent:.1f}"
    if text in ("0.0", "100.0"):
        text = "< 0.1" if percent < 50.0 else "> 99.9"
    return f"{text}\u00a0%"


def counted_states(sweep: SweepTable) -> list[dict[str, object]]:
    """Every state with its count, for tiles; rare ones that no sweep need have only where they occur."""
    always = set(STATES) - {State.NOT_MEASURED, State.INTERRUPTED}
    return [
        {
            "state": state.value,
            "label": state.label,
            "count": count,
            "shown": f"{count:,}",
            "share": share(count, len(sweep)),
        }
        for state, count in sweep.counts.items()
        if count or state in always
    ]


def _runs(count: int) -> str:
    return f"{count:,} run{'' if count == 1 else 's'}"
